"""viser's server, for pages of this machine only."""

import asyncio
import contextlib
import http
import logging
import re
from collections.abc import Generator
from typing import Any

import viser
from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

LOCAL = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:\d+)?", re.IGNORECASE)
LOG = logging.getLogger(__name__)


class LocalServer(viser.ViserServer):
    """A server that answers its own page and refuses pages of other sites.

    Any page open in the same browser can send requests here. A page cannot choose the
    headers `Host`, the name of the requested server, and `Origin`, its own site. viser
    checks neither, and opens a tunnel to the internet on request.
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
            self.stop()
            raise OSError(f"viser {viser.__version__} cannot be served to local pages")

    def request_share_url(self, verbose: bool = True) -> None:
        """Opens no tunnel."""

    def disconnect_share_url(self) -> None:
        """Does nothing: there is no tunnel."""


def refusal(request: Request) -> str | None:
    """Reason to refuse a request; None for our own page, opened on this machine.

    Args:
        request: for a file, or to open a websocket.
    """
    hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
    if len(hosts) != 1 or not LOCAL.fullmatch(hosts[0]):
        return f"Host must be that of this machine, localhost, not {', '.join(hosts)}"
    is_file = "Upgrade" not in request.headers
    if origins != [f"http://{hosts[0]}"] and (origins or not is_file):
        return f"Origin must be http://{hosts[0]}, not {', '.join(origins) or 'absent'}"
    return None


@contextlib.contextmanager
def _checking() -> Generator[list[Any]]:
    """Inside, servers of websockets check requests; yields the servers made.

    viser has no setting for that, so its server function is replaced meanwhile.
    """
    serve, made = websockets_server.serve, list[Any]()

    def checked(handler: Any, *arguments: Any, **settings: Any) -> Any:
        answer = settings.pop("process_request")

        def check(connection: ServerConnection, request: Request) -> Response | None:
            if reason := refusal(request):
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{reason}\n")
            return answer(connection, request)

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
