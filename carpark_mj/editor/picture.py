"""A picture to scale under the drawing, as a site plan or an aerial photograph."""

from pathlib import Path
from typing import NamedTuple

from carpark_mj.reading import read_bytes

KINDS = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".webp": "image/webp",
}


class Picture(NamedTuple):
    """A picture whose middle is the lot's origin.

    Attributes:
        data: of its file.
        kind: media type.
        size: width and height [m].
    """

    data: bytes
    kind: str
    size: tuple[float, float]


def read_picture(path: Path, scale: float = 0.0, width: float = 0.0) -> Picture:
    """Reads a picture.

    Args:
        path: of the file.
        scale: metres per pixel; 0 to use `width`.
        width: of the picture [m].

    Raises:
        ValueError: it is no such picture.
        OSError: it cannot be read.
    """
    from matplotlib.image import imread

    if path.suffix.lower() not in KINDS:
        raise ValueError(f"a picture must end in one of {', '.join(KINDS)}, not {path}")
    data = read_bytes(path)
    try:
        rows, columns = imread(path).shape[:2]
    except Exception as error:  # decoders raise many kinds
        raise ValueError(f"cannot read the picture {path}: {error}") from None
    scale = scale or width / columns
    return Picture(data, KINDS[path.suffix.lower()], (scale * columns, scale * rows))
