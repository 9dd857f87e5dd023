"""The experiments of Pandita 2022 and further ones, with their trainings."""

import dataclasses
from pathlib import Path

from carpark_papers.jobs import Job

EPISODE = 150  # steps: an "episode" of the thesis's arguments is as many steps
VERTICAL, DIAGONAL, PARALLEL = "slots", "slots_diagonal", "slots_parallel"
TWO = f"{VERTICAL},{DIAGONAL}"
THREE = f"{TWO},{PARALLEL}"


@dataclasses.dataclass(frozen=True)
class Claim:
    """A claim of the thesis about a policy at the end of its training."""

    kind: str  # of lot on which it is deployed
    parks: bool  # whether it always parks there, or never


@dataclasses.dataclass(frozen=True)
class SlotsExperiment:
    """A training, and the claims about it."""

    name: str  # number in the thesis, or a word
    title: str  # of the training
    # kinds of lots and the thesis's episodes of `EPISODE` steps, in order
    stages: tuple[tuple[str, int], ...]
    claims: tuple[Claim, ...] = ()  # of the thesis; none beyond its experiments
    statement: str = ""  # claims in its words, shortened
    replay: str = "her"  # `SACConfig.replay`
    flags: tuple[str, ...] = ()  # further settings, as words of a command line

    def phases(self, scale: float) -> tuple[str, ...]:
        """`SACConfig.phases`, with budgets scaled."""
        return tuple(
            f"{kinds}:{max(1, round(count * EPISODE * scale))}"
            for kinds, count in self.stages
        )


def _claims(parks: str = "", fails: str = "") -> tuple[Claim, ...]:
    """One for each kind, in strings with commas."""
    good = [Claim(kind, True) for kind in parks.split(",") if kind]
    return (*good, *(Claim(kind, False) for kind in fails.split(",") if kind))


_RATE_1 = "deployed 30 times: success rate 1"
_ALL_CRASH = "deployed 30 times on diagonal slots: all crash"
_PHASED = ((VERTICAL, 150), (DIAGONAL, 150))
_HER_PHASED = ((VERTICAL, 125), (DIAGONAL, 125))

EXPERIMENTS = (
    SlotsExperiment(
        "1",
        "no buffer, vertical",
        ((VERTICAL, 1000),),
        _claims(fails=VERTICAL),
        "gets near, one success, then crashes only",
        "none",
    ),
    SlotsExperiment(
        "2",
        "plain buffer, vertical",
        ((VERTICAL, 100),),
        _claims(VERTICAL),
        _RATE_1,
        "plain",
    ),
    SlotsExperiment(
        "3",
        "plain buffer, diagonal",
        ((DIAGONAL, 100),),
        _claims(DIAGONAL),
        _RATE_1,
        "plain",
    ),
    SlotsExperiment(
        "4",
        "plain buffer, vertical, deployed on diagonal",
        ((VERTICAL, 100),),
        _claims(fails=DIAGONAL),
        _ALL_CRASH,
        "plain",
    ),
    SlotsExperiment(
        "5",
        "plain buffer, vertical then diagonal",
        _PHASED,
        _claims(fails=TWO),
        "time-outs and crashes in training; deployed 30 times: all time out",
        "plain",
    ),
    SlotsExperiment(
        "6",
        "plain buffer, two kinds interleaved",
        ((TWO, 1000),),
        _claims(TWO),
        "only successes after some 1000 episodes; success rate 1",
        "plain",
    ),
    SlotsExperiment(
        "7", "HER, vertical", ((VERTICAL, 100),), _claims(VERTICAL), _RATE_1
    ),
    SlotsExperiment(
        "8", "HER, diagonal", ((DIAGONAL, 100),), _claims(DIAGONAL), _RATE_1
    ),
    SlotsExperiment(
        "9",
        "HER, vertical, deployed on diagonal",
        ((VERTICAL, 100),),
        _claims(fails=DIAGONAL),
        _ALL_CRASH,
    ),
    SlotsExperiment(
        "10",
        "HER, vertical then diagonal",
        _HER_PHASED,
        _claims(DIAGONAL, VERTICAL),
        "vertical: all crash, diagonal: all park; forgetting",
    ),
    SlotsExperiment(
        "11", "HER, two kinds interleaved", ((TWO, 250),), _claims(TWO), _RATE_1
    ),
    SlotsExperiment(
        "12", "HER, three kinds interleaved", ((THREE, 1200),), _claims(THREE), _RATE_1
    ),
    SlotsExperiment(
        "three-phases",
        "HER, one kind after the other",
        ((VERTICAL, 400), (DIAGONAL, 400), (PARALLEL, 400)),
    ),
    SlotsExperiment(
        "rehearsal-5",
        "as 10, 5 % of the later episodes on the old kind",
        _HER_PHASED,
        flags=("--rehearsal", "0.05"),
    ),
    SlotsExperiment(
        "rehearsal-20",
        "as 10, 20 % of the later episodes on the old kind",
        _HER_PHASED,
        flags=("--rehearsal", "0.2"),
    ),
    SlotsExperiment(
        "balance",
        "as 10, both phases equally often in the batches",
        _HER_PHASED,
        flags=("--at-switch", "balance"),
    ),
    SlotsExperiment(
        "clear",
        "as 10, the buffer emptied at the switch",
        _HER_PHASED,
        flags=("--at-switch", "clear"),
    ),
    SlotsExperiment(
        "physical",
        "as 12, a real car",
        ((THREE, 1200),),
        flags=("--environment", "slots"),
    ),
)


def slots_experiment(name: str) -> SlotsExperiment:
    """The experiment of a name."""
    for experiment in EXPERIMENTS:
        if experiment.name == name:
            return experiment
    names = ", ".join(experiment.name for experiment in EXPERIMENTS)
    raise ValueError(f"unknown experiment {name!r}; choose from {names}")


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
