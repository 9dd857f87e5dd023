"""The commands of `carpark_mj`, and the programs of papers and extensions."""

import dataclasses
import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from carpark_mj.cli.process import (
    configure_jax,
    dispatch_synchronously,
    enable_output_fusion,
    keep_compiled_programs,
)
from carpark_mj.extensions import Entry, Registry
from carpark_mj.rendering.gl import choose_gl

ACTING = (dispatch_synchronously, enable_output_fusion, keep_compiled_programs)


@dataclasses.dataclass(frozen=True)
class Command:
    """A command, imported when it is called.

    Attributes:
        home: `module:Config` of the settings, in whose module `main(config)` does the
            work; or `module:function` of the arguments.
        summary: what it does, in a line.
        setup: called before the import, which may load MuJoCo, and before JAX computes.
        drives: its help names the pretrained policies.
    """

    home: str
    summary: str
    setup: tuple[Callable[[], object], ...] = ()
    drives: bool = False

    def load(self) -> Any:
        """Imports the config or the function."""
        module, _, name = self.home.partition(":")
        return getattr(importlib.import_module(module), name)


COMMANDS = {
    "train": Command(
        "carpark_mj.programs.train:run",
        "train a policy with PPO",
        (choose_gl, configure_jax, keep_compiled_programs),
    ),
    "evaluate": Command(
        "carpark_mj.cli.evaluate:EvaluateConfig",
        "evaluate a policy on held-out seeds",
        ACTING,
        drives=True,
    ),
    "render": Command(
        "carpark_mj.cli.render:RenderConfig",
        "render episodes to a video or a still",
        (choose_gl, *ACTING),
        drives=True,
    ),
    "scene": Command(
        "carpark_mj.cli.scene:SceneConfig",
        "write a car park as MJCF, or show it",
        drives=True,
    ),
    "play": Command(
        "carpark_mj.cli.play:PlayConfig",
        "drive a car yourself",
        (keep_compiled_programs,),
        drives=True,
    ),
    "layouts": Command(
        "carpark_mj.cli.layouts:LayoutsConfig", "draw, plot, check and save layouts"
    ),
    "layouts edit": Command(
        "carpark_mj.cli.layout_files:EditConfig", "draw a lot in the browser"
    ),
    "layouts import": Command(
        "carpark_mj.cli.layout_files:ImportConfig", "make a layout of a map"
    ),
    "vehicles": Command(
        "carpark_mj.cli.vehicles:VehiclesConfig",
        "show a vehicle and its estimated parameters",
    ),
    "identify": Command(
        "carpark_mj.cli.vehicles:IdentifyConfig",
        "find a car's parameters in the log of a drive",
        (enable_output_fusion,),
    ),
    "oracle": Command(
        "carpark_mj.cli.oracle:OracleConfig",
        "say which agents of held-out lots can park",
        (enable_output_fusion, keep_compiled_programs),
    ),
    "suite": Command(
        "carpark_mj.suite.evaluation:SuiteConfig",
        "compare policies on the held-out hard cases",
        (choose_gl, *ACTING),
        drives=True,
    ),
    # Without output fusion: XLA 0.10 dies of it here (openxla/xla#47367).
    "export": Command(
        "carpark_mj.cli.export:ExportConfig",
        "export a policy as an ONNX model",
        (keep_compiled_programs,),
        drives=True,
    ),
    "sweep": Command(
        "carpark_mj.sweeps:SweepConfig", "train every combination of some settings"
    ),
    "analysis": Command(
        "carpark_mj.cli.analysis:AnalysisConfig", "compare runs: tables, plots, a page"
    ),
    "benchmark": Command(
        "carpark_mj.benchmarking:BenchmarkConfig",
        "measure speed, compilation and memory",
        (enable_output_fusion,),
    ),
    "study": Command(
        "carpark_mj.programs:study", "run a program of a paper or an extension"
    ),
}

STUDY_PROGRAMS: Registry[Entry] = Registry("program")


def run(name: str, arguments: Sequence[str] | None = None) -> object:
    """Sets this process up and runs a command.

    Args:
        name: of `COMMANDS`.
        arguments: of the command line; None = those of this process.

    Returns:
        The exit code if it is an int; other values mean 0.
    """
    for prepare in COMMANDS[name].setup:
        prepare()
    return call(name, sys.argv[1:] if arguments is None else arguments)


def call(name: str, arguments: Sequence[str]) -> object:
    """Runs a command in a process that is set up, see `run`."""
    words = list(arguments)
    if words and f"{name} {words[0]}" in COMMANDS:
        return call(f"{name} {words[0]}", words[1:])
    command = COMMANDS[name]
    target = command.load()
    if not isinstance(target, type):
        return target(words)
    from carpark_mj.cli.flags import help_of, read_flags

    description = help_of(target)
    if command.drives:
        from carpark_mj.cli.driver import command_help

        description = command_help(description)
    module = sys.modules[target.__module__]
    words = getattr(module, "complete", list)(words)  # of `--view` alone
    prog = f"carpark_mj {name}"
    return module.main(read_flags(target, words, description=description, prog=prog))


class _Described(Protocol):
    @property
    def summary(self) -> str: ...


def table(programs: Mapping[str, _Described]) -> str:
    """A line for each program."""
    width = max(map(len, programs), default=0)
    return "\n".join(
        f"  {name:{width}}  {program.summary}" for name, program in programs.items()
    )


def study(arguments: Sequence[str]) -> object:
    """Runs a program of a paper or another extension, which the first argument names.

    Raises:
        ValueError: there is no such program, or none at all.
    """
    choose_gl()  # before an extension imports MuJoCo
    if not STUDY_PROGRAMS:
        raise ValueError(
            "no program is installed: those of the papers come with carpark_papers, "
            "`pip install ./papers` in a checkout of carpark_mj"
        )
    if not arguments or arguments[0] in ("-h", "--help"):
        print(f"usage: carpark_mj study NAME ...\n\n{table(STUDY_PROGRAMS)}")
        return 0
    program = STUDY_PROGRAMS[arguments[0]]
    sys.argv = [f"carpark_mj study {arguments[0]}", *arguments[1:]]
    return program.load()(list(arguments[1:]))
