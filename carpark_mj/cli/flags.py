"""Flags from frozen dataclasses, through tyro; errors are one sentence, not a box."""

import contextlib
import difflib
import inspect
import io
import itertools
import os
import re
import sys
import typing
from collections.abc import Generator, Mapping, Sequence
from typing import Any, TypeVar

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from carpark_mj import config as known  # its names load what they are of
from carpark_mj.config.checks import Range
from carpark_mj.extensions import FORMATS, VARIABLE, unknown_name
from carpark_mj.pretrained import describe_names

Config = TypeVar("Config")


def _range(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Range] | None:
    """Two numbers that the help calls LOW HIGH."""
    origin, items = typing.get_origin(info.type), typing.get_args(info.type)
    if origin is not tuple or items != typing.get_args(Range):  # or typing.Tuple
        return None
    return PrimitiveConstructorSpec(
        nargs=2,
        metavar="LOW HIGH",
        instance_from_str=lambda words: (float(words[0]), float(words[1])),
        is_instance=lambda value: isinstance(value, tuple) and len(value) == 2,
        str_from_instance=lambda value: [str(number) for number in value],
    )


def _extra_terms(info: StructTypeInfo) -> StructConstructorSpec | None:
    """A flag for every setting of every registered reward term, as in `extra.haste`."""
    read: Any = info.type
    # Looking the kind up imports JAX.
    if not (inspect.isclass(read) and issubclass(read, Mapping)):
        return None
    if read is not (kind := known.ExtraTerms):
        return None
    given = info.default if isinstance(info.default, kind) else kind()

    def build(**values: float | None) -> Mapping[str, float]:
        ordered = {**given, **values}.items()  # terms of the default first
        return kind({key: value for key, value in ordered if value is not None})

    number: Any = float | None  # None = not given
    fields = [
        StructFieldSpec(key, number, given.get(key), known.REWARD_TERMS[name].meaning)
        for name in known.REWARD_TERMS
        for key in known.term_settings(name)
    ]
    return StructConstructorSpec(build, tuple(fields))


_REGISTRY = ConstructorRegistry()
_REGISTRY.primitive_rule(_range)
_REGISTRY.struct_rule(_extra_terms)

PYTHON_WORDS = {
    ": invalid literal for int() with base 10:": " takes a whole number, not",
    ": could not convert string to float:": " takes a number, not",
}


def read_flags(
    cls: type[Config],
    arguments: Sequence[str] | None = None,
    default: Config | None = None,
    description: str | None = None,
    prog: str | None = None,
) -> Config:
    """Reads the flags of a dataclass; `ValueError` of an impossible one is a sentence.

    The flag `--….encoding NAME` of an observation chooses that encoder, and its flags.

    Args:
        cls: each field is a flag; the class's docstring is its help.
        arguments: the command line; None = that of the process.
        default: values of flags that are not given; None = `cls()`.
        description: at the head of the help.
        prog: name of the program in the help; None = that of its file.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    # Tyro joins lines that begin with a letter; commands have lines of their own.
    command = r"(?m)^(?=(carpark_mj|python|srun) )"
    text = description and re.sub(command, "    ", description)
    options: Any = {"description": text, "prog": prog, "registry": _REGISTRY}
    if "--help-all" in arguments:
        arguments = ["--help"]
    default = _with_encoders(cls, arguments, default)
    if default is not None:
        options["default"] = default
    if {"-h", "--help"} & {*arguments}:
        return tyro.cli(cls, args=["--help"], **options)
    with _stderr_as_text() as box:
        try:
            return tyro.cli(cls, args=arguments, **options)
        except SystemExit:
            if not box.getvalue():
                raise
    raise ValueError(_sentence(box.getvalue(), prog))


def as_flags(settings: Mapping[str, str], config: Any) -> list[str]:
    """Settings of a config, values by dotted name, as flags for `read_flags`."""
    words: list[str] = []
    for field, value in settings.items():
        *groups, last = field.replace("_", "-").split(".")
        parts, now = value.split(), None
        with contextlib.suppress(ValueError):  # tyro says what is unknown
            now = known.setting(config, field)
        if isinstance(now, bool):
            if value.lower() not in ("true", "false"):
                raise ValueError(f"{field} must be true or false, not {value!r}")
            last, parts = last if value.lower() == "true" else f"no-{last}", []
        if any(re.match(r"-[^\d.]", part) for part in parts):
            raise ValueError(f"{field} takes values, not flags, as in {value!r}")
        words += [f"--{'.'.join((*groups, last))}", *parts]
    return words


def _with_encoders(
    cls: type[Config], arguments: Sequence[str], default: Config | None
) -> Config | None:
    """The default with the encoders that flags ask for, their settings by default."""
    for word, after in itertools.pairwise([*arguments, ""]):
        flag, equals, value = word.partition("=")
        path = flag.removeprefix("--").removesuffix(".encoding")
        if flag != f"--{path}.encoding":
            continue
        config = cls() if default is None else default
        try:
            now = known.setting(config, path)
        except ValueError:
            continue  # no such flag, which tyro says
        if isinstance(now, known.ObservationConfig):
            encoder = known.ENCODERS[value if equals else after]
            if type(now) is not encoder:
                # Checked with the other flags, some of which may belong to it.
                default = known.insert(config, {path: encoder()})
    return default


@contextlib.contextmanager
def _stderr_as_text() -> Generator[io.StringIO]:
    """Captures stderr, with lines wide enough to keep words whole."""
    columns = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "100000"
    try:
        with contextlib.redirect_stderr(io.StringIO()) as text:
            yield text
    finally:
        del os.environ["COLUMNS"]
        if columns is not None:
            os.environ["COLUMNS"] = columns


def command_help(text: str) -> str:
    """The head of a command's help, with the names of the pretrained policies."""
    return f"{text}\n\nPretrained policies: {describe_names()}."


def _sentence(box: str, prog: str | None) -> str:
    """Tyro's message in a box on stderr as one line, without the box and its title."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", box)
    lines = [line.strip("│ ") for line in text.splitlines()]
    # Under the title: within the frame, or below a rule where there is no UTF-8.
    under = lines[1:] if lines[0].startswith("╭") else lines[2:]
    message = itertools.takewhile(lambda x: not re.fullmatch(r"[─╰╯-]*", x), under)
    sentence = re.sub(r"^Error parsing (\w+: )?", "", " ".join(message))
    for words, plain in PYTHON_WORDS.items():
        sentence = sentence.replace(words, plain)
    unknown = re.search(r"--[\w.-]+", sentence)
    meant = re.findall(r"^--\w[\w.-]*", "\n".join(lines), re.MULTILINE)
    named = f"{prog} {unknown[0]}".removeprefix("carpark_mj ") if unknown else ""
    if sentence.startswith("Unrecognized") and named in FORMATS["flag"]:
        return unknown_name("flag", named, ())
    # Tyro lists them in another order.
    near = unknown and difflib.get_close_matches(unknown[0], meant, 1, 0.0)
    if near:
        sentence = f"{sentence}; perhaps you meant {near[0]}"
    if unknown and ".extra." in unknown[0]:
        sentence = f"{sentence}, or the term of a module to name in {VARIABLE}"
    return sentence
