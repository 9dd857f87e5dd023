"""The programs of the command `carpark_mj`, and those of studies and extensions."""

import dataclasses

from carpark_mj.extensions import Registry


@dataclasses.dataclass(frozen=True)
class Program:
    """A program of the command line.

    Attributes:
        entry: `module:function` that runs it; imported when it is run.
        summary: what it does, in a line.
    """

    entry: str
    summary: str


COMMANDS = {
    "train": Program("carpark_mj.programs.train:run", "train a policy with PPO"),
    "evaluate": Program(
        "carpark_mj.programs.evaluate:run", "evaluate a policy on held-out seeds"
    ),
    "render": Program(
        "carpark_mj.programs.render:run", "render episodes to a video or a still"
    ),
    "scene": Program(
        "carpark_mj.cli.scene:run", "write a car park as MJCF, or show it"
    ),
    "play": Program("carpark_mj.cli.play:run", "drive a car yourself"),
    "layouts": Program("carpark_mj.cli.layouts:main", "plot, check and save layouts"),
    "suite": Program(
        "carpark_mj.programs.suite:run", "compare policies on the held-out hard cases"
    ),
    "export": Program(
        "carpark_mj.programs.export:run", "export a policy as an ONNX model"
    ),
    "sweep": Program(
        "carpark_mj.programs.sweep:run", "train every combination of some settings"
    ),
    "analysis": Program(
        "carpark_mj.programs.analysis:run", "compare runs: tables, plots, a page"
    ),
    "study": Program(
        "carpark_mj.programs.study:run", "run a program of a study or an extension"
    ),
}

STUDY_PROGRAMS: Registry[Program] = Registry("program of a study")


def table(programs: dict[str, Program]) -> str:
    """A line for each program."""
    width = max(map(len, programs), default=0)
    return "\n".join(
        f"  {name:{width}}  {program.summary}" for name, program in programs.items()
    )
