"""The document of the editor: a layout file, its draft, its faults, and a picture.

The picture lies to scale under the drawing, as a site plan or an aerial photograph.
"""

import re
from pathlib import Path
from typing import Any, NamedTuple

from carpark_mj.files import write_text
from carpark_mj.layouts.checks import ANY_CAR, list_faults
from carpark_mj.layouts.files import (
    FORMAT,
    complete,
    document_text,
    parse_layout,
    read_unchecked,
)
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.reading import read_bytes, read_object

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
        empty = {"format": FORMAT, "bays": [], "spawns": [], "extent": [*extent]}
        self.saved = complete(empty) if source is None else _read(source)
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
        layout = parse_layout(document)
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
    read_unchecked(path)
    return complete(read_object(path))


def _write(path: Path, document: dict[str, Any]) -> None:
    write_text(path, document_text(complete(document)))
