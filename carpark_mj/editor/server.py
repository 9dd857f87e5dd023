"""Serves the editor's page, checks what it draws, and writes files.

A picture may lie to scale under the drawing, as a site plan or an aerial photograph.
"""

import http
import json
import re
import shlex
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, NamedTuple

from carpark_mj.files import write_text
from carpark_mj.layouts import files
from carpark_mj.layouts.checks import ANY_CAR, list_faults
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.reading import parse_object, read_bytes, read_object
from carpark_mj.rendering.local_pages import HOST, NO_FRAMES, listening, refusal

KINDS = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".webp": "image/webp",
}
EXTENT = (20.0, 15.0)  # m, half widths of a new lot


class Picture(NamedTuple):
    """A picture whose middle is the lot's origin."""

    data: bytes
    kind: str  # media type
    size: tuple[float, float]  # width and height [m]


def read_picture(path: Path, width: float) -> Picture:
    """Reads a picture of a width [m]."""
    from matplotlib.image import imread

    if path.suffix.lower() not in KINDS:
        raise ValueError(f"a picture must end in one of {', '.join(KINDS)}, not {path}")
    data = read_bytes(path)
    try:
        rows, columns = imread(path).shape[:2]
    except Exception as error:  # decoders raise many kinds
        raise ValueError(f"cannot read the picture {path}: {error}") from None
    return Picture(data, KINDS[path.suffix.lower()], (width, width / columns * rows))


class Draft:
    """A layout file that is edited; changes that are not saved are kept beside it."""

    def __init__(
        self, out: Path, source: Path | None = None, extent: Any = EXTENT
    ) -> None:
        """Opens the unsaved changes of `out`, if there are any, or the source.

        That may have faults; None = an empty lot of these half widths [m].
        """
        self.out = out
        self.kept = out.with_suffix(".draft.json")  # of unsaved changes
        empty = {"format": files.FORMAT, "bays": [], "spawns": [], "extent": [*extent]}
        self.saved = files.complete(empty) if source is None else _read(source)
        # As the page last had it.
        self.document = _read(self.kept) if self.kept.exists() else self.saved

    def check(self, document: dict[str, Any]) -> list[dict[str, Any]]:
        """Faults of the lot as it now is, which is kept if it can be read again."""
        faults = find_faults(document)
        if not any("unreadable" in fault for fault in faults):
            self.document = document
            if document == self.saved:
                self.kept.unlink(missing_ok=True)
            else:
                _write(self.kept, document)
        return faults

    def save(self, document: dict[str, Any]) -> list[dict[str, Any]]:
        """Writes the file unless a fault is grave; returns the faults."""
        faults = self.check(document)
        if not any(fault["grave"] for fault in faults):
            _write(self.out, document)
            self.saved = document
            self.kept.unlink(missing_ok=True)
        return faults


def find_faults(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Faults of a lot, for the page.

    Each has its `text`; the `places` at fault, lists of rows such as "bays/3"; whether
    it is `grave`, so that no environment takes the lot, or concerns the design car
    only; and `unreadable` if the lot cannot be read again.
    """
    try:
        layout = files.parse_layout(document)
    except (ValueError, RecursionError) as error:
        rows = re.findall(r"\b(\w+)\[(\d+)\]", str(error))[:1]
        places = [[f"{kind}/{row}"] for kind, row in rows]
        fault = {"text": str(error), "places": places}
        return [fault | {"grave": True, "unreadable": True}]
    found: list[dict[str, Any]] = []
    of_any_car = {x.message: x.places.tolist() for x in list_faults(layout, ANY_CAR)}
    for message, kinds, places in list_faults(layout, DesignCar().size):
        hard = {tuple(place) for place in of_any_car.get(message, [])}
        for grave in (True, False):
            rows = [
                [f"{kind}s/{row}" for kind, row in zip(kinds, place, strict=True)]
                for place in places.tolist()
                if (tuple(place) in hard) == grave
            ]
            if rows:
                found.append({"text": message, "places": rows, "grave": grave})
    return found


def _read(path: Path) -> dict[str, Any]:
    """Reads a layout file, which may have faults but not in its format."""
    files.read_unchecked(path)
    return files.complete(read_object(path))


def _write(path: Path, document: dict[str, Any]) -> None:
    write_text(path, files.document_text(files.complete(document)))


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
        with listening(port):
            super().__init__((HOST, port), _Handler)

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
            "choices": files.choices(),
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
