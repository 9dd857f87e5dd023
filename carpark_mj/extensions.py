"""Registries: parts of the gym by name, ours and those of other packages.

A part is registered under a name when its module is imported. Looking up an
unregistered name imports the core's own parts, then the extensions:

- the suite of hard cases, `carpark_mj.suite`;
- the modules that installed packages name as entry points of `GROUP`;
- the modules that the environment variable `VARIABLE` lists, separated by commas.

The core imports none of them, and every program finds all of them. Packages that the
core does without come with extras, which messages name where one is missing.
"""

import contextlib
import dataclasses
import difflib
import functools
import importlib
import importlib.metadata
import importlib.util
import os
from collections.abc import Generator, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

GROUP = "carpark_mj.extensions"
VARIABLE = "CARPARK_MJ_EXTENSIONS"

T = TypeVar("T")
_loaded: set[str] = set()
_broken: dict[str, str] = {}  # why an extension cannot be imported


# Names that come with carpark_formats, by their kinds; only messages need them.
FORMATS = {
    "command": ("layouts import", "scenario import", "scenario export", "serve"),
    "level": ("parkbench",),
    "format to save": ("osm", "xodr"),
    "format to export": ("onnx",),
    "kind of policy": ("onnx",),
    "flag": ("export --from-state",),
}


def unknown_name(kind: str, name: object, known: Iterable[str]) -> str:
    """The message about an unknown name: what has it, or the closest known one."""
    if name in FORMATS.get(kind, ()):
        install = "`pip install ./formats` in a checkout of carpark_mj"
        return f"the {kind} {name!r} comes with carpark_formats: {install}"
    names = sorted(known)
    near = difflib.get_close_matches(str(name), names, 1)
    meant = f"; did you mean {near[0]!r}?" if near else ""
    return f"unknown {kind} {name!r}; choose from {names}{meant}"


def table(lines: Mapping[str, str], indent: int = 2) -> str:
    """A line for each name."""
    width = max(map(len, lines), default=0)
    return "\n".join(
        f"{'':{indent}}{n:{width}}  {x}".rstrip() for n, x in lines.items()
    )


@dataclasses.dataclass(frozen=True)
class Entry:
    """A part that is imported on first use."""

    home: str  # `module:name` where it is
    summary: str = ""  # what it is, in a line

    def load(self) -> Any:
        """Imports it."""
        module, _, name = self.home.partition(":")
        return getattr(importlib.import_module(module), name)


class Registry(Mapping[str, T], Generic[T]):
    """Parts of one kind by name; looking a name up may import the extensions.

    A part may be registered as an `Entry`: looking it up imports it.

    Examples:
        >>> cars: Registry[float] = Registry("car")
        >>> cars.register("mini", 3.05)
        3.05
        >>> cars["mini"]
        3.05
    """

    def __init__(self, kind: str, *homes: str) -> None:
        """An empty registry of parts of a kind, which messages name.

        Homes are modules that register the core's own parts; a look-up imports them in
        this order until one has registered the name.
        """
        self._kind = kind
        self.homes = homes
        self._parts: dict[str, T] = {}

    def register(self, name: str, part: T) -> T:
        """Adds a part, and returns it; raises `ValueError` if the name is taken."""
        if not name or not name.replace("_", "a").replace("-", "a").isalnum():
            raise ValueError(
                f"the name of a {self._kind} must be of letters, digits, _ and -, "
                f"not {name!r}"
            )
        if self._parts.get(name, part) is not part:
            raise ValueError(f"there is a {self._kind} {name!r} already")
        self._parts[name] = part
        return part

    def name_of(self, part: T) -> str | None:
        """The first name that an equal part has been registered under so far."""
        equal = (name for name, other in self._parts.items() if other == part)
        return next(equal, None)

    def __getitem__(self, name: str) -> T:
        """The part of that name; `ValueError` of an unknown one lists the known."""
        if name not in self:
            raise ValueError(unknown_name(self._kind, name, self._parts))
        part: Any = self._parts[name]
        return part.load() if isinstance(part, Entry) else part

    @property
    def summaries(self) -> dict[str, str]:
        """A line on each part registered so far as an entry, and "" on others."""
        return {n: getattr(x, "summary", "") for n, x in sorted(self._parts.items())}

    def __contains__(self, name: object) -> bool:
        if not isinstance(name, str):  # from a file; a list could not even be looked up
            return False
        for home in self.homes:
            if name in self._parts:
                return True
            importlib.import_module(home)
        if name not in self._parts:
            load_extensions()
        return name in self._parts

    def __iter__(self) -> Iterator[str]:
        self._load()
        return iter(sorted(self._parts))

    def __len__(self) -> int:
        self._load()
        return len(self._parts)

    def _load(self) -> None:
        for home in self.homes:
            importlib.import_module(home)
        load_extensions()


def load_extensions(packages: bool = False) -> None:
    """Imports extensions not imported yet; a `ValueError` says why one cannot be.

    Or only the `packages` that they are in, which register programs.
    """
    for module in _extensions(os.environ.get(VARIABLE, "")):
        name = module.partition(".")[0] if packages else module
        if name not in _loaded:
            _loaded.add(name)  # first: while it is imported it may look names up
            try:
                importlib.import_module(name)
            except Exception as error:
                why = " ".join(str(error).split()) or type(error).__name__
                if isinstance(error, ModuleNotFoundError) and error.name == name:
                    why += "; install it, or put its folder into PYTHONPATH"
                _broken[name] = why
        # Not tried again: parts registered before the failure exist already.
        if name in _broken:
            raise ValueError(
                f"the extension {name} cannot be imported: {_broken[name]}"
            )


@functools.cache  # registries ask at every look, and reading entry points takes 1 ms
def _extensions(named: str) -> tuple[str, ...]:
    """The modules of all extensions, each once; `named` is the variable's value."""
    names = ["carpark_mj.suite"]
    names += [point.module for point in importlib.metadata.entry_points(group=GROUP)]
    names += [name for name in named.split(",") if name]
    return tuple(dict.fromkeys(names))


# Packages by the extras that install them.
_PACKAGES = {
    "train,eval": "tyro rich matplotlib tensorboardX imageio_ffmpeg scipy",
    "torchrl": "torchrl benchmarl",
    "web": "mjviser",
    "video": "moviepy",
    "planner": "ompl shapely",
    "sb3": "sbx stable_baselines3",
    "sweep": "submitit",
    "sb3,torchrl": "torch",
    "fmu": "pythonfmu3",
    "test": "vehiclemodels",
    **{name: name for name in ("jaxmarl", "minari", "mlflow", "pettingzoo", "wandb")},
}
EXTRAS = {name: extra for extra, names in _PACKAGES.items() for name in names.split()}


def missing_extra(error: ModuleNotFoundError) -> str | None:
    """The error with the command that installs the package, None if no extra has it."""
    extra = EXTRAS.get((error.name or "").partition(".")[0])
    if extra is None or "pip install" in str(error):
        return extra and str(error)
    clone = Path(__file__).resolve().parents[1]
    if (clone / "pyproject.toml").exists():
        return f'{error}: pip install -e "{clone}[{extra}]"'
    return f'{error}: pip install "carpark_mj[{extra}]"'


@contextlib.contextmanager
def naming_extras() -> Generator[None]:
    """Names the extra to install if an import inside misses a package of `EXTRAS`."""
    try:
        yield
    except ModuleNotFoundError as error:
        message = missing_extra(error)
        if message is None:
            raise
        raise ModuleNotFoundError(message, name=error.name) from None


def require_packages(*names: str) -> None:
    """Raises `ModuleNotFoundError` for the first package that is not installed."""
    for name in names:
        if importlib.util.find_spec(name) is None:
            with naming_extras():
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)
