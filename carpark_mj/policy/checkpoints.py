"""Checkpoints: one `.npz` file of named arrays and a JSON header, no pickles.

Files are written atomically. Reading checks the header, the names, shapes and dtypes; a
fault raises a one-line `CheckpointError`.
"""

import contextlib
import json
from collections.abc import Generator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.files import write_atomically
from carpark_mj.reading import Archive, ArrayForm, parse_object, require_entries

FORMAT = "carpark_mj checkpoint 1"
_HEADER = "header"


class CheckpointError(ValueError):
    """A checkpoint that is missing, truncated, foreign or does not fit."""


@contextlib.contextmanager
def refused_as(what: str) -> Generator[None]:
    """Makes errors about values inside a `CheckpointError` that begins with `what`."""
    try:
        yield
    except CheckpointError:
        raise
    except KeyError as error:
        raise CheckpointError(f"{what}: no setting {error}") from None
    except (TypeError, ValueError) as error:
        raise CheckpointError(f"{what}: {error}") from None


def _named_leaves(tree: Any) -> dict[str, Any]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path): leaf for path, leaf in leaves}


def is_key(leaf: Any) -> bool:
    """Whether it is an array of PRNG keys."""
    dtype = getattr(leaf, "dtype", None)
    return dtype is not None and jnp.issubdtype(dtype, jax.dtypes.prng_key)


def save(path: Path, tree: Any, header: dict[str, Any]) -> None:
    """Writes a pytree of arrays, numbers and keys to an `.npz`, with a JSON header."""
    arrays: dict[str, Any] = {
        name: np.asarray(jax.random.key_data(leaf) if is_key(leaf) else leaf)
        for name, leaf in _named_leaves(tree).items()
    }
    text = json.dumps({"format": FORMAT, **header})
    arrays[_HEADER] = np.frombuffer(text.encode(), np.uint8)
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


@contextlib.contextmanager
def _open(path: Path) -> Generator[Archive]:
    """Opens a checkpoint; faults raise `CheckpointError`."""
    try:
        archive = Archive(path)
        if _HEADER not in archive.names:
            raise ValueError(f"{path} is not a carpark_mj checkpoint")
        yield archive
    except FileNotFoundError:
        raise CheckpointError(f"no checkpoint at {path}") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None)
        message = f"{path} cannot be read: {reason}" if reason else str(error)
        raise CheckpointError(message) from None


def read_header(path: Path, **kinds: type) -> dict[str, Any]:
    """Reads the header of a checkpoint, with entries `kinds` of these types."""
    form = ArrayForm(np.dtype(np.uint8), ("bytes",))
    with _open(path) as archive:
        data = archive.read({_HEADER: form})[_HEADER].tobytes()
        header = parse_object(data.decode(errors="replace"), f"the header of {path}")
        if header.get("format") != FORMAT:
            raise ValueError(
                f"{path} has format {header.get('format')!r}, this version reads "
                f"{FORMAT!r}"
            )
        require_entries(header, f"the header of {path}", **kinds)
    return header


def names(path: Path) -> list[str]:
    """Names of the arrays in a checkpoint, each the path in its pytree."""
    with _open(path) as archive:
        return [name for name in archive.names if name != _HEADER]


def load(path: Path, template: Any) -> Any:
    """Reads the arrays of a checkpoint into the structure of `template`.

    Arrays of the file that the template does not name are ignored, so a policy can be
    read out of a whole training state.
    """
    read_header(path)
    leaves = _named_leaves(template)
    with _open(path) as archive:
        arrays: Any = archive.read({name: _form(leaf) for name, leaf in leaves.items()})
    for name in (name for name, leaf in leaves.items() if is_key(leaf)):
        arrays[name] = jax.random.wrap_key_data(jnp.asarray(arrays[name]))
    return jax.tree.unflatten(jax.tree.structure(template), arrays.values())


def require_finite(path: Path, tree: Any) -> None:
    """Refuses parameters that would make a policy act on NaN."""
    for name, leaf in _named_leaves(tree).items():
        if not np.isfinite(leaf).all():
            raise CheckpointError(f"{path} holds numbers at {name} that are not finite")


def _form(leaf: Any) -> ArrayForm:
    """Dtype and shape of the array of a leaf."""
    if is_key(leaf):
        leaf = jax.eval_shape(jax.random.key_data, leaf)
    elif not hasattr(leaf, "dtype"):
        leaf = np.asarray(leaf)
    return ArrayForm(np.dtype(leaf.dtype), tuple(leaf.shape))
