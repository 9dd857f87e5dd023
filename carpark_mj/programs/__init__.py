"""The programs of the command `carpark_mj`, and those of papers and extensions."""

from collections.abc import Mapping

from carpark_mj.extensions import Entry, Registry

COMMANDS = {
    "train": Entry("carpark_mj.programs.train:run", "train a policy with PPO"),
    "evaluate": Entry(
        "carpark_mj.programs.evaluate:run", "evaluate a policy on held-out seeds"
    ),
    "render": Entry(
        "carpark_mj.programs.render:run", "render episodes to a video or a still"
    ),
    "scene": Entry("carpark_mj.cli.scene:run", "write a car park as MJCF, or show it"),
    "play": Entry("carpark_mj.cli.play:run", "drive a car yourself"),
    "layouts": Entry(
        "carpark_mj.cli.layouts:main", "draw, plot, check and save layouts"
    ),
    "vehicles": Entry(
        "carpark_mj.cli.vehicles:main", "show a vehicle and its estimated parameters"
    ),
    "identify": Entry(
        "carpark_mj.cli.identify:main", "find a car's parameters in the log of a drive"
    ),
    "oracle": Entry(
        "carpark_mj.cli.oracle:main", "say which agents of held-out lots can park"
    ),
    "suite": Entry(
        "carpark_mj.programs.suite:run",
        "compare policies on the held-out hard cases",
    ),
    "export": Entry(
        "carpark_mj.programs.export:run", "export a policy as an ONNX model"
    ),
    "sweep": Entry(
        "carpark_mj.programs.sweep:run", "train every combination of some settings"
    ),
    "analysis": Entry(
        "carpark_mj.programs.analysis:run", "compare runs: tables, plots, a page"
    ),
    "benchmark": Entry(
        "carpark_mj.programs.benchmark:run", "measure speed, compilation and memory"
    ),
    "study": Entry(
        "carpark_mj.programs.study:run", "run a program of a paper or an extension"
    ),
}

STUDY_PROGRAMS: Registry[Entry] = Registry("program")


def table(programs: Mapping[str, Entry]) -> str:
    """A line for each program."""
    width = max(map(len, programs), default=0)
    return "\n".join(
        f"  {name:{width}}  {program.summary}" for name, program in programs.items()
    )
