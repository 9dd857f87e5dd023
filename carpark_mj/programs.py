"""The commands of `carpark_mj`, and the programs of papers and extensions."""

import dataclasses
import inspect
import sys
from collections.abc import Callable, Sequence
from typing import Any

from carpark_mj.cli.clock import CLOCK
from carpark_mj.cli.process import (
    configure_jax,
    dispatch_synchronously,
    enable_output_fusion,
)
from carpark_mj.compilation import compile_for_one_lot, keep_compiled_programs
from carpark_mj.extensions import (
    FORMATS,
    Entry,
    Registry,
    load_extensions,
    require_packages,
    table,
    unknown_name,
)
from carpark_mj.rendering.gl import choose_gl

ACTING = (dispatch_synchronously, enable_output_fusion, keep_compiled_programs)
KEEPING = (keep_compiled_programs,)
SHOWING = (compile_for_one_lot, keep_compiled_programs)
TRAINING = (choose_gl, configure_jax, keep_compiled_programs)


@dataclasses.dataclass(frozen=True)
class Command(Entry):
    """A command: a function of its settings, or of the words of the command line.

    Its settings are a config class, whose docstring is the help. The settings are read
    before the function is imported, without JAX.
    """

    settings: str = ""  # `module:name` of the class; "" = the words
    # Called before the function is imported, which may load MuJoCo, and JAX computes.
    setup: tuple[Callable[[], object], ...] = ()
    drives: bool = False  # its help names the pretrained policies
    needs: tuple[str, ...] = ()  # packages of extras without which it is refused
    reads: bool = False  # the function reads the words itself, unless they ask for help
    extended: bool = False  # an extension's package may replace it


def _command(
    home: str, summary: str, settings: str = "", *others: Any, **more: Any
) -> Command:
    settings = settings and f"carpark_mj.cli.settings.{settings}"
    return Command(f"carpark_mj.{home}", summary, settings, *others, **more)


# Packages of extensions add theirs when they are imported.
COMMANDS = {
    "train": _command(
        "programs:train", "train a policy with PPO",
        "training:TrainConfig", TRAINING, needs=("tyro", "tensorboardX"), reads=True,
    ),
    "evaluate": _command(
        "cli.evaluate:main", "evaluate a policy on held-out seeds",
        "driving:EvaluateConfig", ACTING, drives=True,
    ),
    "render": _command(
        "cli.render:main", "render episodes to a video or a still",
        "driving:RenderConfig", (choose_gl, dispatch_synchronously, *SHOWING),
        drives=True,
    ),
    "record": _command(
        "cli.record:main", "record a policy's episodes as data to learn from",
        "driving:RecordConfig", ACTING, drives=True,
    ),
    "scene": _command(
        "cli.pages:scene", "write a car park as MJCF, or show it",
        "driving:SceneConfig", SHOWING, drives=True,
    ),
    "play": _command(
        "cli.pages:play", "drive a car yourself",
        "driving:PlayConfig", SHOWING, drives=True,
    ),
    "list": _command(
        "cli.listing:main", "list layouts, environments, vehicles, policies, presets",
        "lots:ListConfig",
    ),
    "layouts": _command(
        "cli.layouts:main", "draw, plot, check and save layouts",
        "lots:LayoutsConfig", KEEPING,
    ),
    "layouts edit": _command(
        "cli.layouts:edit", "draw a lot in the browser", "lots:EditConfig"
    ),
    "vehicles": _command(
        "cli.vehicles:show", "show a vehicle and its estimated parameters",
        "lots:VehiclesConfig",
    ),
    "identify": _command(
        "cli.vehicles:fit", "find a car's parameters in the log of a drive",
        "lots:IdentifyConfig", (enable_output_fusion, keep_compiled_programs),
    ),
    "suite": _command(
        "suite.evaluation:main", "compare policies on the held-out hard cases",
        "tables:SuiteConfig", (choose_gl, *ACTING), drives=True,
        needs=("matplotlib",),
    ),
    "scenario": _command(
        "suite.scenario:main", "test policies in a case of your own",
        "tables:ScenarioConfig", (choose_gl, *ACTING), drives=True,
        needs=("matplotlib",),
    ),
    "report": _command(
        "suite.page:main", "write a page about tests, with limits",
        "tables:ReportConfig", needs=("matplotlib",),
    ),
    "export": _command(
        "cli.driver:export", "write a policy as a checkpoint of its own",
        "driving:ExportConfig", drives=True, extended=True,
    ),
    "sweep": _command(
        "sweeps:main", "train every combination of some settings",
        "tables:SweepConfig", needs=("submitit",),
    ),
    "analysis": _command(
        "cli.analysis:main", "compare runs: tables, plots, a page",
        "tables:AnalysisConfig",
    ),
    "benchmark": _command(
        "benchmarking:main", "measure speed, compilation and memory",
        "tables:BenchmarkConfig", (enable_output_fusion,),
    ),
    "study": _command("programs:study", "run a program of a paper or an extension"),
}  # fmt: skip

STUDY_PROGRAMS: Registry[Any] = Registry("program")


def find(words: Sequence[str]) -> tuple[str, list[str]]:
    """The command that the first word or two name, and the words after its name.

    Raises:
        ValueError: no such command, also not of an extension's package.
    """
    pair, name = " ".join(words[:2]), words[0]
    if pair in COMMANDS or pair in FORMATS["command"]:
        name = pair
    if name not in COMMANDS or COMMANDS[name].extended:
        load_extensions(packages=True)
    if name not in COMMANDS:
        raise ValueError(unknown_name("command", name, COMMANDS))
    return name, [*words[1 + (name != words[0]) :]]


def run(
    name: str, arguments: Sequence[str] | None = None, set_up: bool = True
) -> object:
    """Runs one of `COMMANDS`; gives the exit code if that is an int, others mean 0.

    By default the arguments are this process's; `set_up` sets it up first.
    """
    name, words = find([name, *(sys.argv[1:] if arguments is None else arguments)])
    command = COMMANDS[name]
    reads = command.reads and not {"-h", "--help"} & {*words}
    given = words if reads or not command.settings else _read(name, command, words)
    require_packages(*command.needs)
    for prepare in command.setup if set_up else ():
        prepare()
    function = command.load()
    if given is not words:
        CLOCK.set("working")
    return function(given)


def _read(name: str, command: Command, words: Sequence[str]) -> Any:
    """The settings of a command."""
    from carpark_mj.cli.flags import command_help, read_flags

    settings = Entry(command.settings).load()
    text = _head(settings)
    if command.drives:
        text = command_help(text)
    return read_flags(settings, words, description=text, prog=f"carpark_mj {name}")


def _head(settings: Any) -> str:
    return (inspect.getdoc(settings) or "").partition("\n\nAttributes:")[0]


def study(arguments: Sequence[str]) -> object:
    """Runs the program of a paper or an extension that the first argument names."""
    choose_gl()  # before an extension imports MuJoCo
    load_extensions(packages=True)
    if not (STUDY_PROGRAMS.summaries or STUDY_PROGRAMS):
        raise ValueError(
            "no program is installed: those of the papers come with carpark_papers, "
            "`pip install ./papers` in a checkout of carpark_mj"
        )
    if not arguments or arguments[0] in ("-h", "--help"):
        print(f"usage: carpark_mj study NAME ...\n\n{table(STUDY_PROGRAMS.summaries)}")
        return 0
    program = STUDY_PROGRAMS[arguments[0]]
    keep_compiled_programs()
    sys.argv = [f"carpark_mj study {arguments[0]}", *arguments[1:]]
    return program(list(arguments[1:]))


def train(arguments: Sequence[str]) -> int:
    """Trains, with other hosts if asked; returns the exit code."""
    from carpark_mj.training.hosts import joined, read_hosts

    hosts, arguments = read_hosts(arguments)
    with joined(hosts):
        return _train(arguments)


def _train(arguments: Sequence[str]) -> int:
    import jax

    from carpark_mj.cli.settings.training import TrainConfig
    from carpark_mj.training.ppo.config import PPOConfig
    from carpark_mj.training.ppo.parts import PRESETS, summaries
    from carpark_mj.training.run_folder import read_runs, read_settings

    hardware = "gpu" if jax.default_backend() == "gpu" else "cpu"

    def read(arguments: Sequence[str]) -> PPOConfig:
        presets = PRESETS[hardware], PRESETS
        return read_settings(*presets, arguments, _head(TrainConfig), summaries())

    configs = read_runs(arguments, read)
    # After the help and the refusals, which do without.
    from carpark_mj.training.loop import read_metrics
    from carpark_mj.training.ppo.train import FEW_UPDATES, MAX_SKIPPED, train_runs

    ended = train_runs(configs)
    stopped = [str(folder) for folder, outcome in ended if outcome == "stopped"]
    if stopped:
        print(f"stopped; continue with: carpark_mj train --resume {' '.join(stopped)}")
    for folder, outcome in ended:
        # Other hosts have no files of the runs.
        if outcome == "done" and jax.process_index() == 0:
            made = len(read_metrics(folder))
            few = f"only {made} updates, too few to learn"
            few += ": more --minutes or --num-steps"
            print(f"{'done' if made >= FEW_UPDATES else few}: {folder}")
        if outcome == "diverged":
            print(
                f"ppo: {MAX_SKIPPED} updates in a row were non-finite; the "
                f"checkpoints in {folder} are older",
                file=sys.stderr,
            )
    return int(any(outcome == "diverged" for _, outcome in ended))
