"""viser's server, for pages of this machine only."""

import asyncio
import contextlib
import http
import io
import logging
from collections.abc import Generator
from typing import Any

import viser
from websockets.asyncio import server as websockets_server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from carpark_mj.rendering.local_pages import NO_FRAMES, refusal

LOG = logging.getLogger(__name__)


class LocalServer(viser.ViserServer):
    """A server that answers its own page and refuses pages of other sites.

    viser does not check the senders of requests (`local_pages.refusal`), and opens a
    tunnel to the internet on request.
    """

    def __init__(self, host: str, port: int, label: str) -> None:
        """Serves on a port, or the next free one; `OSError` if it cannot check."""
        # Browsers open connections that they may never use.
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        with _checking() as servers, contextlib.redirect_stdout(io.StringIO()):
            super().__init__(host, port, label, verbose=False)
        if len(servers) != 1:
            super().stop()
            raise OSError(f"viser {viser.__version__} cannot be served to local pages")
        self._serving = servers[0].server

    def stop(self) -> None:
        """Stops without waiting for the idle connections that browsers keep open."""
        for connection in [*self._serving.handlers]:
            self._serving.loop.call_soon_threadsafe(connection.transport.abort)
        with contextlib.redirect_stdout(io.StringIO()):  # it prints that it stopped
            super().stop()

    def request_share_url(self, verbose: bool = True) -> None:
        """Opens no tunnel."""

    def disconnect_share_url(self) -> None:
        """Does nothing: there is no tunnel."""


@contextlib.contextmanager
def _checking() -> Generator[list[Any]]:
    """Inside, new servers, which it yields, check requests: viser has no setting."""
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
