"""Evaluates a policy on held-out seeds: tables, `evaluation.csv`, `evaluation.json`.

In a mixture of families also a table with a row per family, and `families.csv`.
docs/metrics.md says what every number is.

python eval/evaluate.py runs/cpu-0
python eval/evaluate.py runs/cpu-mixture-0
python eval/evaluate.py --policy random --episodes 500
python eval/evaluate.py --policy zero --environment tanner-fixed
"""

import csv
import dataclasses
import io
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import jax
import tyro
from rich.console import Console
from rich.table import Table

from carpark_mj.cli.common import USER_ERRORS, keep_compiled_programs, one_line
from carpark_mj.config import EnvConfig, MetricsConfig, ParkedRule, PhysicsName
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.catalogue import DRIVING, GOALS, SAFETY
from carpark_mj.evaluation.rollout import (
    HITS,
    OUTCOMES,
    Evaluation,
    evaluate,
    random_policy,
    zero_policy,
)
from carpark_mj.policy.checkpoints import CheckpointError, write_atomically
from carpark_mj.policy.networks import Policy
from carpark_mj.policy.runs import load_policy, write_json
from carpark_mj.registry import environment

BASELINES = {"zero": zero_policy, "random": random_policy}


@dataclasses.dataclass(frozen=True)
class EvaluateConfig:
    """Settings of `python eval/evaluate.py`.

    Attributes:
        run: run folder or checkpoint file; or give `--policy`.
        policy: `zero`, `random`, or a run folder or checkpoint file.
        environment: of `zero` and `random`, by name, `tanner-fixed` for example; see
            `carpark_mj.registry`.
        episodes: whole episodes, rounded up to the same number per agent.
        seed: of the held-out lots; training never uses these keys.
        rule: judge by another parked rule than the run was trained under.
        num_agents: another number of agents than the run was trained with.
        layout: another lot than the run was trained in: a name or a layout file, or
            several with commas between.
        num_parked_cars: another number of parked cars.
        physics: another back end: `scene` judges crashes by the contacts of one MuJoCo
            world.
        stochastic: sample actions instead of taking the distribution's mode.
        out: folder of the CSV and JSON; default: the run folder, or `runs/NAME` for
            a baseline.
    """

    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")] = ""
    policy: str = ""
    environment: str = ""
    episodes: int = 1024
    seed: int = 0
    rule: ParkedRule | None = None
    num_agents: int | None = None
    layout: str | None = None
    num_parked_cars: int | None = None
    physics: PhysicsName | None = None
    stochastic: bool = False
    out: str = ""

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise ValueError(f"episodes must be at least 1, not {self.episodes}")


def main(config: EvaluateConfig) -> Evaluation:
    """Evaluates, prints the table and writes the files.

    Raises:
        CheckpointError: the run cannot be read.
        ValueError: impossible settings.
        OSError: the output folder cannot be written.
    """
    if bool(config.run) == bool(config.policy):
        raise ValueError(
            "give either a run folder or --policy zero|random|RUN, "
            f"not {'both' if config.run else 'neither'}"
        )
    name = config.run or config.policy
    driver = find_driver(name, config.environment, not config.stochastic)
    folder = Path(config.out) if config.out else driver.folder
    env_config = adapt(
        driver.env,
        rule=config.rule,
        num_agents=config.num_agents,
        num_parked_cars=config.num_parked_cars,
        layout=config.layout,
        physics=config.physics,
        metrics=MetricsConfig(driving=True, safety=True),
    )
    env = ParkingEnv(env_config)
    folder.mkdir(parents=True, exist_ok=True)  # unwritable? Say so before the work.
    policy = driver.policy(env)
    result = evaluate(env, policy, config.episodes, config.seed)
    title = f"{name}: {env_config.num_agents} agents, {env_config.episode.parked_rule}"
    title = (
        f"{title} rule, {env_config.layout} lot, {env_config.physics} physics, "
        f"seed {config.seed}"
    )
    print_table(result.summary, title)
    print_metrics(result.summary["metrics"])
    if len(result.families) > 1:
        print_families(result)
    settings = {"policy": name, **dataclasses.asdict(config)}
    written = write_evaluation(folder, result, settings)
    print(f"wrote {', '.join(map(str, written))}")
    return result


@dataclasses.dataclass(frozen=True)
class Driver:
    """Who is to drive, and where.

    Attributes:
        env: the environment, of a run the one it was trained in.
        folder: where files about it go.
        policy: makes the acting function for an environment.
    """

    env: EnvConfig
    folder: Path
    policy: Callable[[ParkingEnv], Policy]


def find_driver(name: str, named: str, deterministic: bool = True) -> Driver:
    """Finds a baseline or the policy of a run.

    Args:
        name: `zero`, `random`, or a run folder or checkpoint file.
        named: name of a baseline's environment; empty = the default one.
        deterministic: take a distribution's mode instead of samples.

    Raises:
        CheckpointError: the run cannot be read.
        ValueError: unknown environment, or one given for a run, which has its own.
    """
    if name in BASELINES:
        env = environment(named) if named else EnvConfig()
        make = BASELINES[name]
        return Driver(env, Path("runs") / name, lambda env: make(env.action_spec))
    if named:
        raise ValueError(f"environment is for zero and random; {name} has its own")
    loaded = load_policy(Path(name), deterministic)
    folder = loaded.path.parent
    folder = folder.parent if folder.name == "checkpoints" else folder
    return Driver(loaded.env, folder, lambda env: loaded.policy)


def adapt(env: EnvConfig, rule: ParkedRule | None = None, **changes: Any) -> EnvConfig:
    """The environment with other settings, where they are not None."""
    if rule is not None:
        changes["episode"] = dataclasses.replace(env.episode, parked_rule=rule)
    given = {name: value for name, value in changes.items() if value is not None}
    physics = given.get("physics", env.physics)
    if (physics == "grid") != (env.physics == "grid"):
        raise ValueError(
            f"a policy for {env.physics} physics cannot drive on {physics}: actions "
            "are whole numbers on the grid and continuous elsewhere"
        )
    return dataclasses.replace(env, **given)


def write_evaluation(folder: Path, result: Evaluation, settings: Any) -> list[Path]:
    """Writes `evaluation.csv` (episodes) and `evaluation.json` (summaries).

    Of a mixture also `families.csv`, a row per family and one for all of them.

    Returns:
        The files.
    """
    written = [folder / "evaluation.csv", folder / "evaluation.json"]
    _write_csv(written[0], result.episodes)
    data = {
        "settings": settings,
        "device": jax.devices()[0].device_kind,
        "summary": result.summary,
    }
    if len(result.families) > 1:
        data["families"] = result.families
        written.append(folder / "families.csv")
        _write_csv(written[2], _family_rows(result))
    write_json(written[1], data)
    return written


def _write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, lambda temporary: temporary.write_text(text.getvalue()))


def _family_rows(result: Evaluation) -> list[dict[str, Any]]:
    """Episodes, counts, rates and intervals of every family, and of all together."""
    rows: list[dict[str, Any]] = []
    for family, summary in {**result.families, "all": result.summary}.items():
        row: dict[str, Any] = {"family": family, "episodes": summary["episodes"]}
        for outcome in OUTCOMES:
            for name, value in summary[outcome].items():
                row[f"{outcome}_{name}"] = value
        rows.append(row)
    return rows


def print_families(result: Evaluation) -> None:
    """Prints the outcomes of every family, with 95 % intervals."""
    table = Table(title="by family: rate, and below it the 95 % interval [%]")
    table.add_column("family")
    for column in ("episodes", "parked", "crashed", "timed out"):
        table.add_column(column, justify="right")
    for family, summary in {**result.families, "all": result.summary}.items():
        rates = [summary[name] for name in ("parked", "crashed", "timed_out")]
        table.add_row(
            family,
            f"{summary['episodes']}",
            *(
                f"{r['rate']:.1%}\n{100 * r['low']:.1f} … {100 * r['high']:.1f}"
                for r in rates
            ),
            end_section=family == list(result.families)[-1],
        )
    Console().print(table)


def print_table(summary: dict[str, Any], title: str) -> None:
    """Prints rates with 95 % intervals and means."""
    table = Table(title=f"{title}: {summary['episodes']} episodes")
    for column in ("outcome", "rate", "95 % interval", "episodes"):
        table.add_column(column, justify="left" if column == "outcome" else "right")
    for name in OUTCOMES + HITS:
        row = summary[name]
        label = name.replace("_", " ")
        table.add_row(
            f"  {label}" if name in HITS else label,
            f"{row['rate']:.1%}",
            f"{row['low']:.1%} … {row['high']:.1%}",
            f"{row['count']:.0f}",
        )
    console = Console()
    console.print(table)
    if "wrong_way_share" in summary:
        share = summary["wrong_way_share"]
        console.print(f"{share:.1%} of the way driven against the lanes")
    if not summary["parked"]["count"]:
        console.print("no parked episode to describe")
        return
    console.print(
        f"parked episodes: {summary['parked_time']:.1f} s, "
        f"{summary['parked_path']:.1f} m driven, "
        f"{summary['parked_gear_changes']:.1f} gear changes; off by "
        f"{summary['parked_distance_error']:.2f} m, "
        f"{summary['parked_heading_error_deg']:.1f} deg at "
        f"{summary['parked_speed']:.2f} m/s"
    )


def print_metrics(metrics: dict[str, Any]) -> None:
    """Prints how the episodes were driven, and how safely."""
    table = Table(title="driving and safety (docs/metrics.md)")
    for column in ("metric", "unit", "mean", "median", "worst 5 %", "worst"):
        table.add_column(
            column, justify="left" if column in ("metric", "unit") else "right"
        )
    shown = [m for m in DRIVING + SAFETY + GOALS if m.name in metrics]
    for metric in shown:
        value = metrics[metric.name]
        numbers = ["", *value.values()] if isinstance(value, dict) else [value]
        table.add_row(
            metric.name.replace("_", " "),
            metric.unit,
            *(n if isinstance(n, str) else f"{n:.3g}" for n in numbers),
            end_section=metric in (DRIVING[-1], SAFETY[-1]),
        )
    Console().print(table)


if __name__ == "__main__":
    keep_compiled_programs()
    try:
        main(tyro.cli(EvaluateConfig, description=__doc__))
    except (CheckpointError, *USER_ERRORS) as error:
        print(f"evaluate: {one_line(error)}", file=sys.stderr)
        sys.exit(2)
