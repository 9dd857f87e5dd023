"""Serves the editor's page, checks what it draws, and writes files."""

import http
import json
import shlex
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from carpark_mj.editor.document import Draft, Picture
from carpark_mj.layouts.files import choices
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.reading import parse_object
from carpark_mj.rendering.local_pages import HOST, NO_FRAMES, refusal

PAGE = Path(__file__).parent / "page"
TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
ALONE = "--env.num-agents 1 --env.num-parked-cars 1"  # fits in any lot of two bays
MOST_BYTES = 2**23  # of a document
# No foreign requests.
POLICY = f"default-src 'self'; img-src 'self' data:; {NO_FRAMES}"


class EditorServer(ThreadingHTTPServer):
    """The editor of one layout file, on this machine only."""

    daemon_threads = True

    def __init__(self, draft: Draft, port: int, picture: Picture | None = None) -> None:
        """Listens on a port, or on a free one if it is 0."""
        self.draft, self.picture, self.turn = draft, picture, threading.Lock()
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            raise OSError(
                f"cannot serve on port {port}: {error.strerror}; choose one with --port"
            ) from None

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Prints the error unless the browser has only dropped a connection."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    def opened(self) -> dict[str, Any]:
        """What the page begins with."""
        lot = shlex.quote(str(self.draft.out))
        return {
            "name": self.draft.out.name,
            "car": DesignCar().size,
            "commands": [
                ("Drive here", f"carpark_mj play --layout {lot}"),
                ("Train here", f"carpark_mj train --env.layout {lot} {ALONE}"),
            ],
            "document": self.draft.document,
            "saved": self.draft.saved,
            "choices": choices(),
            "picture": self.picture and self.picture.size,
        }


class _Handler(BaseHTTPRequestHandler):
    server: EditorServer  # pyright: ignore[reportIncompatibleVariableOverride]

    def do_GET(self) -> None:
        if self._refused(reads=True):
            return
        name = self.path.partition("?")[0].removeprefix("/") or "index.html"
        picture = self.server.picture
        if name == "lot":
            self._answer_json(self.server.opened())
        elif name == "picture" and picture:
            self._answer(picture.data, picture.kind)
        elif name in {path.name for path in PAGE.iterdir()}:
            path = PAGE / name
            self._answer(path.read_bytes(), f"{TYPES[path.suffix]}; charset=utf-8")
        else:
            self.send_error(http.HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        """Checks a document, and saves it on request."""
        if self._refused(reads=False):
            return
        draft = self.server.draft
        work = {"/check": draft.check, "/save": draft.save}.get(self.path)
        length = self.headers.get("Content-Length", "")
        if work is None:
            return self.send_error(http.HTTPStatus.NOT_FOUND)
        if not length.isdecimal() or int(length) > MOST_BYTES:
            return self.send_error(http.HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        try:
            text = self.rfile.read(int(length)).decode()
            with self.server.turn:
                faults = work(parse_object(text, "the drawing"))
        except (OSError, ValueError) as error:
            return self._answer_json({"error": str(error)}, http.HTTPStatus.CONFLICT)
        self._answer_json({"faults": faults})

    def _refused(self, reads: bool) -> bool:
        hosts, origins = (self.headers.get_all(x, []) for x in ("Host", "Origin"))
        reason = refusal(hosts, origins, reads)
        if reason:
            self.send_error(http.HTTPStatus.FORBIDDEN, explain=reason)
        return reason is not None

    def _answer_json(self, value: Any, status: int = http.HTTPStatus.OK) -> None:
        self._answer(json.dumps(value).encode(), "application/json", status)

    def _answer(self, data: bytes, kind: str, status: int = http.HTTPStatus.OK) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Prints nothing."""
