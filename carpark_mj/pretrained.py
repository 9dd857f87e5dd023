"""The pretrained policies of the package, by name; nothing heavy is imported."""

from pathlib import Path

FOLDER = Path(__file__).resolve().parent / "policy" / "pretrained"


def pretrained_names() -> list[str]:
    """Names of the policies in the package, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.npz"))


def describe_names() -> str:
    """The names in a sentence's form: `a, b, c`, or `none`."""
    return ", ".join(pretrained_names()) or "none"
