"""Pretrained policies: `<name>.npz`, written by `carpark_mj export`, and `<name>.md`.

The markdown file is the model card: task, training command, rates and limits;
docs/policies.md shows them all.
"""

from pathlib import Path

from carpark_mj.config.checks import require_kind
from carpark_mj.policy.checkpoints import CheckpointError

FOLDER = Path(__file__).resolve().parent


def pretrained_names() -> list[str]:
    """Names of the policies in the package, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.npz"))


def describe_names() -> str:
    """The names in a sentence's form: `a, b, c`, or `none`."""
    return ", ".join(pretrained_names()) or "none"


def find_policy(run: str | Path) -> Path:
    """The file of a pretrained policy, or the path of a run.

    Args:
        run: name of a pretrained policy, or a path; a `Path` is never a name.

    Returns:
        The path, which may not exist.

    Raises:
        CheckpointError: a name that is also a path in the working directory.
        TypeError: neither.
    """
    require_kind("run", run, str | Path)
    if isinstance(run, Path) or run not in pretrained_names():
        return Path(run)
    if Path(run).exists():
        raise CheckpointError(
            f"{run} is a pretrained policy and a path in this folder: write ./{run} "
            "for the path, or rename it"
        )
    return FOLDER / f"{run}.npz"
