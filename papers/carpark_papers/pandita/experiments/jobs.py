"""The trainings of the experiments in slots."""

from pathlib import Path

from carpark_papers.jobs import Job
from carpark_papers.pandita.experiments.slots import SlotsExperiment


def make_job(
    experiment: SlotsExperiment, preset: str, scale: float, seed: int, folder: Path
) -> Job:
    """The training of an experiment with a seed, in a folder below `folder`."""
    phases = experiment.phases(scale)
    slug = "+".join(phase.replace(",", "-").replace(":", "_") for phase in phases)
    extra = "".join(experiment.flags).replace("--", "-")
    name = f"{experiment.replay}-{slug}{extra}-{seed}"
    if preset != "study":
        name = f"{preset}-{name}"
    flags = ("--preset", preset, "--name", name, "--runs-dir", str(folder))
    flags += ("--seed", str(seed), "--video-seconds", "0", "--phases", *phases)
    flags += ("--replay", experiment.replay, *experiment.flags)
    return Job("sac", folder / name, flags)
