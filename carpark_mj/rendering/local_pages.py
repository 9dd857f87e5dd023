"""Pages for browsers on this machine: addresses and access."""

import contextlib
import re
from collections.abc import Generator, Sequence
from typing import Annotated

from carpark_mj.config.checks import Bounds

# No other page may frame ours, where it could direct clicks.
NO_FRAMES = "frame-ancestors 'none'"
HOST, PORT = "localhost", 8080
# Bounded: viser would silently choose another one.
Port = Annotated[int, Bounds(ge=1, le=65_535)]
LOCAL = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:\d+)?", re.IGNORECASE)


@contextlib.contextmanager
def listening(port: int) -> Generator[None]:
    """Names the port and its flag if a server inside cannot listen there."""
    try:
        yield
    except OSError as error:
        raise OSError(
            f"cannot serve on port {port}: {error.strerror}; choose one with --port"
        ) from None


def refusal(hosts: Sequence[str], origins: Sequence[str], reads: bool) -> str | None:
    """Reason to refuse a request; None for our own page, opened on this machine.

    Any page open in the same browser can send requests here. A page cannot choose the
    headers `Host`, the name of the requested server, and `Origin`, its own site.
    `reads` is whether the request is for a file and changes nothing.
    """
    if len(hosts) != 1 or not LOCAL.fullmatch(hosts[0]):
        return f"Host must be that of this machine, localhost, not {', '.join(hosts)}"
    if [*origins] != [f"http://{hosts[0]}"] and (origins or not reads):
        return f"Origin must be http://{hosts[0]}, not {', '.join(origins) or 'absent'}"
    return None
