"""Pages for browsers on this machine: where they are served, who may use them."""

import re
from collections.abc import Sequence

# No other page may frame ours, where it could direct clicks.
NO_FRAMES = "frame-ancestors 'none'"
HOST, PORT = "localhost", 8080
LAST_PORT = 65_535
LOCAL = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:\d+)?", re.IGNORECASE)


def check_port(port: int) -> None:
    """Refuses a number that is not a port; viser would silently choose another one."""
    if not 1 <= port <= LAST_PORT:
        raise ValueError(f"port must be 1 to {LAST_PORT}, not {port}")


def refusal(hosts: Sequence[str], origins: Sequence[str], reads: bool) -> str | None:
    """Reason to refuse a request; None for our own page, opened on this machine.

    Any page open in the same browser can send requests here. A page cannot choose the
    headers `Host`, the name of the requested server, and `Origin`, its own site.
    `reads` tells whether the request is for a file and changes nothing.
    """
    if len(hosts) != 1 or not LOCAL.fullmatch(hosts[0]):
        return f"Host must be that of this machine, localhost, not {', '.join(hosts)}"
    if [*origins] != [f"http://{hosts[0]}"] and (origins or not reads):
        return f"Origin must be http://{hosts[0]}, not {', '.join(origins) or 'absent'}"
    return None
