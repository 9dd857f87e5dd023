"""Pages for browsers on this machine: where they are served, who may use them."""

import asyncio
import contextlib
import http
import logging
import re
from collections.abc import Generator, Sequence
from typing import Any

import viser
from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

# No other page may frame ours, where it could direct clicks.
NO_FRAMES = "frame-ancestors 'none'"
HOST, PORT = "localhost", 8080
LAST_PORT = 65_535
LOCAL = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:\d+)?", re.IGNORECASE)


def check_port(port: int) -> None:
    """Refuses a number that is not a port; viser would silently choose another one.

    Raises:
        ValueError: naming it.
    """
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


LOG = logging.getLogger(__name__)


class LocalServer(viser.ViserServer):
    """A server that answers its own page and refuses pages of other sites.

    viser does not check who sends requests (`local_pages.refusal`), and opens a tunnel
    to the internet on request.
    """

    def __init__(self, host: str, port: int, label: str) -> None:
        """Serves on a port, or the next free one.

        Raises:
            OSError: this viser does not let requests be checked.
        """
        # Browsers open connections that they may never use.
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        with _checking() as servers:
            super().__init__(host, port, label, verbose=False)
        if len(servers) != 1:
            super().stop()
            raise OSError(f"viser {viser.__version__} cannot be served to local pages")
        self._serving = servers[0].server

    def stop(self) -> None:
        """Stops without waiting for the idle connections that browsers keep open."""
        for connection in [*self._serving.handlers]:
            self._serving.loop.call_soon_threadsafe(connection.transport.abort)
        super().stop()

    def request_share_url(self, verbose: bool = True) -> None:
        """Opens no tunnel."""

    def disconnect_share_url(self) -> None:
        """Does nothing: there is no tunnel."""


@contextlib.contextmanager
def _checking() -> Generator[list[Any]]:
    """Inside, servers of websockets check requests; yields the servers made.

    viser has no setting for that, so its server function is replaced meanwhile.
    """
    serve, made = websockets_server.serve, list[Any]()

    def checked(handler: Any, *arguments: Any, **settings: Any) -> Any:
        answer = settings.pop("process_request")

        def check(connection: ServerConnection, request: Request) -> Response | None:
            hosts, origins = map(request.headers.get_all, ("Host", "Origin"))
            if reason := refusal(hosts, origins, "Upgrade" not in request.headers):
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{reason}\n")
            response = answer(connection, request)
            if response is not None:
                response.headers["Content-Security-Policy"] = NO_FRAMES
            return response

        async def handle(connection: ServerConnection) -> None:
            try:
                await handler(connection)
            except Exception as error:  # what came is no message of viser's
                _say(error)

        asyncio.get_running_loop().set_exception_handler(
            lambda _, context: _say(context.get("exception") or context["message"])
        )
        made.append(serve(handle, *arguments, process_request=check, **settings))
        return made[-1]

    websockets_server.serve = checked  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield made
    finally:
        websockets_server.serve = serve


def _say(reason: object) -> None:
    LOG.warning("a message of the page was ignored: %r", reason)
