"""The figures of Tanner 2022, chapter 5: trainings, published values, verdicts.

`tanner_2022.csv` has the 329 PPO runs of arXiv 2206.13338's result files: a row each,
metrics over the last 20 % of the steps by the names of `carpark_mj.evaluation`. Points
per step became m/s (0.5625 m / 16 points in 0.2 s), levels of turning rad/s (15 deg in
0.2 s), world units metres (0.5625 m). Runs without global information are labelled
(L,L,.): their result file names no context, and they behave like (G,L,.).

The values of the swept settings are taken from the published runs, `tanner_2022.csv`.
"""

import csv
import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from carpark_mj.analysis import Point, Record, Spread, show, spread
from carpark_mj.files import write_atomically
from carpark_mj.sweeps.plan import Axis, Plan
from carpark_mj.types import OUTCOMES

PATH = Path(__file__).parent / "tanner_2022.csv"
SOURCE = "Tanner 2022"


def published_runs(figures: Sequence[str]) -> list[Record]:
    """The runs behind some figures."""
    return [record for behind, record in _read() if behind == "+".join(figures)]


def published_values(figures: Sequence[str], field: str) -> tuple[str, ...]:
    """The values that a setting has in them, smallest first."""
    values = {record.settings[field] for record in published_runs(figures)}
    return tuple(sorted(values, key=_order))


@functools.cache
def _read() -> tuple[tuple[str, Record], ...]:
    found: list[tuple[str, Record]] = []
    with PATH.open(newline="") as file:
        for row in csv.DictReader(file):
            figures, words, repeat = (
                row.pop(name) for name in ("figures", "settings", "repeat")
            )
            settings = dict(word.split("=", 1) for word in words.split())
            metrics = {name: float(value) for name, value in row.items() if value}
            name = f"{words} {repeat}"
            found.append((figures, Record(name, settings, metrics, int(repeat))))
    return tuple(found)


def _order(value: str) -> tuple[bool, float, str]:
    try:
        return False, float(value), ""
    except ValueError:
        return True, 0.0, value


# Episodes of the comparisons in docs/study.md; the study counts some 60,000 in the last
# fifth of a training.
EVAL_EPISODES = "3584"
_SCHEME, _GLOBAL = "env.giving_way.scheme", "env.observation.global_information"


@dataclasses.dataclass(frozen=True)
class Experiment:
    """The runs behind a figure, or behind several."""

    figures: tuple[str, ...]  # their numbers
    title: str  # what is varied
    base: str  # preset
    fields: tuple[str, ...]  # settings that are swept; the first is the horizontal axis
    metrics: tuple[str, ...]  # metrics of the figures
    repeats: int  # published runs of every combination
    # settings that differ from the preset
    fixed: Mapping[str, str] = dataclasses.field(default_factory=dict)
    note: str = ""  # our interpretation where the study is silent

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"figure-{self.figures[0]}"


EXPERIMENTS = (
    Experiment(
        ("5.4",),
        "discount factor",
        "tanner-fixed",
        ("discount",),
        ("crashed", "parked", "length"),
        1,
    ),
    Experiment(
        ("5.5",),
        "number of agents",
        "tanner-fixed",
        ("env.num_agents",),
        (*OUTCOMES, "nearest_car"),
        3,
        {"num_steps": "14_000_000"},
    ),
    Experiment(
        ("5.6",),
        "number of parked cars, one agent",
        "tanner-fixed",
        ("env.num_parked_cars",),
        OUTCOMES,
        3,
        {"env.num_agents": "1", "num_steps": "6_000_000"},
    ),
    Experiment(
        ("5.7",),
        "number of parked cars, seven agents",
        "tanner-fixed",
        ("env.num_parked_cars",),
        OUTCOMES,
        3,
    ),
    Experiment(
        ("5.8",),
        "number of tracked cars",
        "tanner-fixed",
        ("env.observation.tracked_cars",),
        OUTCOMES,
        3,
    ),
    Experiment(
        ("5.9",),
        "what agents share",
        "tanner-fixed",
        ("env.observation.share.goals", "env.observation.share.speeds"),
        OUTCOMES,
        6,
    ),
    Experiment(
        ("5.10", "5.11"),
        "smoothness reward",
        "tanner-fixed",
        ("env.reward.extra.smoothness",),
        ("yaw_rate", "speed", "crashed", "parked"),
        1,
        {"env.reward.extra.smoothness.by_speed": "1"},
        "times the speed, as the text has it; the result files do not say",
    ),
    Experiment(
        ("5.12", "5.13"),
        "larger hitboxes",
        "tanner-fixed",
        ("env.episode.hitbox_scale",),
        ("nearest_car", *OUTCOMES),
        2,
        {},
        "in training and evaluation, as the published crash rates suggest",
    ),
    Experiment(
        ("5.14",),
        "number of agents, dynamic goals",
        "tanner-dynamic",
        ("env.num_agents",),
        (*OUTCOMES, "length", "lost_untracked"),
        3,
        {"num_steps": "14_000_000"},
    ),
    Experiment(
        ("5.15",),
        "tracked cars and bays, dynamic goals",
        "tanner-dynamic",
        ("env.observation.tracked_cars", "env.goals.num_tracked_bays"),
        (*OUTCOMES, "lost_untracked", "change_goal"),
        3,
    ),
    Experiment(
        ("5.16", "5.17"),
        "penalty for changing goals",
        "tanner-dynamic",
        ("env.reward.goals.change_goal",),
        (
            *OUTCOMES,
            "explore_share",
            "towards_goal",
            "towards_bay",
            "lost_untracked",
            "stop_goal",
        ),
        1,
    ),
    Experiment(
        ("5.18", "5.19", "5.20"),
        "giving way",
        "tanner-dynamic",
        ("env.giving_way.bad_goal", _SCHEME),
        (
            "conformity_local_same",
            "conformity_local_any",
            "conformity_untracked_same",
            "conformity_untracked_other",
            "conformity_global_same",
            "conformity_global_any",
            "parked",
            "crashed",
            "explore_share",
            "lost_untracked",
            "stop_goal",
        ),
        1,
    ),
)

# Figures that are not sweeps of PPO runs.
ELSEWHERE = {
    "5.1": "tabular: carpark_mj study q_learning (docs/q_learning.md)",
    "5.2": "tabular: carpark_mj study q_learning --preset tanner-qlearning-rings",
    "5.3": "no result file is published for it",
}
FIGURES = tuple(f"5.{number}" for number in range(1, 21))


def experiment_of(figure: str) -> Experiment:
    """The experiment of a figure."""
    for experiment in EXPERIMENTS:
        if figure in experiment.figures:
            return experiment
    if figure in ELSEWHERE:
        raise ValueError(f"figure {figure} is not a sweep; {ELSEWHERE[figure]}")
    raise ValueError(f"unknown figure {figure!r}; choose from {', '.join(FIGURES)}")


def plan_of(
    experiment: Experiment,
    repeats: int = 0,
    seed: int = 0,
    changes: tuple[Axis, ...] = (),
) -> Plan:
    """The sweep of an experiment.

    `repeats` counts runs of every combination (0 = as many as published), `seed` is the
    first seed, `changes` replace settings of the experiment.
    """
    changed = {field for axis in changes for field in axis.fields}
    fixed = {"eval_episodes": EVAL_EPISODES, **experiment.fixed}
    axes = [
        _axis(field, published_values(experiment.figures, field))
        for field in experiment.fields
    ]
    axes += [
        Axis((field,), ((value,),))
        for field, value in fixed.items()
        if field not in changed
    ]
    return Plan(experiment.base, (*axes, *changes), repeats or experiment.repeats, seed)


def _axis(field: str, values: tuple[str, ...]) -> Axis:
    """The axis of a setting; what agents see changes with the scheme."""
    if field != _SCHEME:
        return Axis((field,), tuple((value,) for value in values))
    seen = {True: "true", False: "false"}
    return Axis(
        (_SCHEME, _GLOBAL),
        tuple((value, seen[value.startswith("G")]) for value in values),
    )


ENOUGH = 3  # runs for an interval


def verdict(ours: Sequence[float], theirs: Sequence[float]) -> str:
    """Whether runs agree: intervals of the interquartile mean overlap.

    Fewer than three published runs are not decided; the verdict says whether they lie
    among ours.
    """
    ours, theirs = ([x for x in xs if not math.isnan(x)] for xs in (ours, theirs))
    if not ours or not theirs:
        return "not decided: not run" if not ours else "not published"
    if len(ours) < ENOUGH:
        return f"not decided: {len(ours)} of ours"
    if len(theirs) < ENOUGH:
        inside = all(min(ours) <= x <= max(ours) for x in theirs)
        where = "within ours" if inside else "outside ours"
        return f"not decided: {len(theirs)} published, {where}"
    mine, other = spread([ours]), spread([theirs])
    if mine.low <= other.high and other.low <= mine.high:
        return "agrees"
    return f"differs: {'more' if mine.iqm > other.iqm else 'less'}"


def write_verdicts(
    path: Path, points: Sequence[Point], by: Sequence[str], metrics: Sequence[str]
) -> None:
    """Writes a markdown table: a row per metric and point, ours, published, verdict.

    Points are of two sources, ours first, and differ in the settings `by`.
    """
    sources = list(dict.fromkeys(point.source for point in points))
    found = {(point.source, point.values): point for point in points}
    lines = [
        f"| metric | {' | '.join(by)} | {' | '.join(sources)} | verdict |",
        "|" + "---|" * (2 + len(by) + len(sources)),
    ]
    for metric in metrics:
        for values in dict.fromkeys(point.values for point in points):
            numbers = [
                found[source, values].numbers(metric)
                if (source, values) in found
                else []
                for source in sources
            ]
            cells = [metric, *map(show, values)]
            cells += [_cell(spread([each])) for each in numbers]
            cells.append(verdict(*numbers) if len(numbers) == 2 else "")
            lines.append(f"| {' | '.join(cells)} |")
    text = "\n".join(lines) + "\n"
    write_atomically(path, lambda temporary: temporary.write_text(text))


def _cell(found: Spread) -> str:
    if not found.runs:
        return ""
    if math.isnan(found.low):
        return f"{found.iqm:.4g}"
    return f"{found.iqm:.4g} ({found.low:.4g} to {found.high:.4g}, {found.runs} runs)"
