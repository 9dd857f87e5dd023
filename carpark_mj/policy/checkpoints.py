"""Checkpoints: one `.npz` file of named arrays and a JSON header, no pickles.

Files are written atomically. Reading checks the header, the names, shapes and dtypes;
whatever is wrong is one `CheckpointError` in one line.
"""

import io
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.files import write_atomically

FORMAT = "carpark_mj checkpoint 1"
_HEADER = "header"


class CheckpointError(Exception):
    """A checkpoint that is missing, truncated, foreign or does not fit."""


# What NumPy raises of damaged files.
_UNREADABLE = (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error)


def _named_leaves(tree: Any) -> dict[str, Any]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path): leaf for path, leaf in leaves}


def _is_key(leaf: Any) -> bool:
    dtype = getattr(leaf, "dtype", None)
    return dtype is not None and jnp.issubdtype(dtype, jax.dtypes.prng_key)


def _to_numpy(leaf: Any) -> np.ndarray:
    return np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)


def save(path: Path, tree: Any, header: dict[str, Any]) -> None:
    """Writes a pytree of arrays with a JSON-able header.

    Args:
        path: target, ending in `.npz`.
        tree: pytree of arrays, numbers and PRNG keys.
        header: what `read_header` gives back.
    """
    arrays: dict[str, Any] = {
        name: _to_numpy(leaf) for name, leaf in _named_leaves(tree).items()
    }
    text = json.dumps({"format": FORMAT, **header})
    arrays[_HEADER] = np.frombuffer(text.encode(), np.uint8)
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    # NumPy's and zipfile's messages are about pickles and magic numbers.
    return "it is truncated, or another kind of file"


def _open(path: Path) -> Any:
    try:
        # Read whole (a few MB), so that no handle stays open on a damaged file.
        file = np.load(io.BytesIO(path.read_bytes()), allow_pickle=False)
    except FileNotFoundError:
        raise CheckpointError(f"no checkpoint at {path}") from None
    except _UNREADABLE as error:
        raise CheckpointError(
            f"{path} is no readable checkpoint: {_reason(error)}"
        ) from None
    if not isinstance(file, np.lib.npyio.NpzFile) or _HEADER not in file:
        raise CheckpointError(f"{path} is not a carpark_mj checkpoint")
    return file


def _read(file: Any, path: Path, name: str) -> np.ndarray:
    try:
        return file[name]
    except _UNREADABLE as error:
        raise CheckpointError(f"{path} is damaged at {name}: {error}") from None


def read_header(path: Path) -> dict[str, Any]:
    """Reads the header of a checkpoint.

    Raises:
        CheckpointError: missing, damaged or foreign file.
    """
    with _open(path) as file:
        try:
            header = json.loads(_read(file, path, _HEADER).tobytes().decode())
        except (UnicodeDecodeError, json.JSONDecodeError):
            raise CheckpointError(f"{path} has a damaged header") from None
    if not isinstance(header, dict):
        raise CheckpointError(f"{path} has a damaged header")
    if header.get("format") != FORMAT:
        raise CheckpointError(
            f"{path} has format {header.get('format')!r}, this version reads {FORMAT!r}"
        )
    return header


def names(path: Path) -> list[str]:
    """Names of the arrays in a checkpoint, each the path in its pytree.

    Raises:
        CheckpointError: missing, damaged or foreign file.
    """
    with _open(path) as file:
        return [name for name in file.files if name != _HEADER]


def load(path: Path, template: Any) -> Any:
    """Reads the arrays of a checkpoint into the structure of `template`.

    Arrays of the file that the template does not name are ignored, so a policy can be
    read out of a whole training state.

    Raises:
        CheckpointError: missing, damaged or foreign file, or one whose arrays do not
            fit the template.
    """
    read_header(path)
    leaves, treedef = jax.tree_util.tree_flatten_with_path(template)
    values = []
    with _open(path) as file:
        for key_path, leaf in leaves:
            name = jax.tree_util.keystr(key_path)
            if name not in file:
                raise CheckpointError(f"{path} lacks {name}: it is of another kind")
            value = _read(file, path, name)
            if _is_key(leaf):
                value = jax.random.wrap_key_data(jnp.asarray(value))
            if not hasattr(leaf, "dtype"):
                leaf = np.asarray(leaf)
            expected, dtype = leaf.shape, leaf.dtype
            if value.shape != expected or value.dtype != dtype:
                raise CheckpointError(
                    f"{path} holds {name} as {value.dtype}{list(value.shape)}, "
                    f"{dtype}{list(expected)} is needed"
                )
            values.append(value)
    return jax.tree_util.tree_unflatten(treedef, values)
