"""Damaged files, and how a reader takes them."""

import json
import random

BITS, ENDS, SWAPS = "bits", "ends", "swaps"
# What takes the place of a value in JSON.
JUNK = (
    None,
    True,
    -1,
    0,
    1e300,
    10**40,
    "-1",
    "",
    "../../etc/passwd",
    [],
    [1, "x"],
    {},
)


def damaged(data: bytes, seed: int) -> bytes:
    """A file with some bits flipped, its end cut off, or two parts exchanged."""
    rng = random.Random(seed)
    kind = rng.choice((BITS, ENDS, SWAPS))
    if kind == ENDS:
        return data[: rng.randrange(len(data))]
    changed = bytearray(data)
    if kind == BITS:
        for _ in range(rng.choice((1, 1, 1, 4))):
            changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        return bytes(changed)
    first, second = rng.randrange(len(data)), rng.randrange(len(data))
    size = rng.randrange(1, 30)
    one, other = changed[first : first + size], changed[second : second + size]
    changed[first : first + size], changed[second : second + size] = other, one
    return bytes(changed)


def with_junk(settings: dict, seed: int) -> dict:
    """JSON settings in which a value, however deep, is junk, gone, or elsewhere's."""
    rng = random.Random(seed)
    changed = json.loads(json.dumps(settings))
    places = [*_places(changed)]
    inside, name = rng.choice(places)
    kind = rng.choice(("junk", "junk", "gone", "other", "new"))
    if kind == "gone":
        del inside[name]
    elif kind == "new" and isinstance(inside, dict):
        inside["new"] = 1
    elif kind == "other":
        other, key = rng.choice(places)
        inside[name] = json.loads(json.dumps(other[key]))
    else:
        inside[name] = rng.choice(JUNK)
    return changed


def _places(value):
    """Every place in JSON data, as its container and its key."""
    keys = value if isinstance(value, dict) else range(len(value))
    for key in keys:
        yield value, key
        if isinstance(value[key], dict | list):
            yield from _places(value[key])
