"""`carpark_mj evaluate`: whole episodes on held-out seeds, reported."""

import dataclasses
import hashlib
import urllib.parse
from pathlib import Path

from carpark_mj.cli.clock import COMPILING, doing
from carpark_mj.cli.driver import adapted, find_driver
from carpark_mj.cli.settings.driving import EvaluateConfig
from carpark_mj.config import MetricsConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.evaluator import Evaluation, evaluate
from carpark_mj.evaluation.report import print_report, write_evaluation
from carpark_mj.files import require_writable
from carpark_mj.policy.acting import AnyPolicy

# Settings that do not show in the name of an evaluation's folder.
UNNAMED = ("run", "out")
# Settings of another task or other episodes, whatever the environment.
TASK = ("environment", "stochastic", "seed", "horizon", "num_lots", "episodes")
MAX_NAME = 150  # characters of a folder's name; file systems allow 255


@dataclasses.dataclass(frozen=True)
class Task:
    """An evaluation to make."""

    name: str  # of the policy
    policy: AnyPolicy
    env: ParkingEnv  # with changes of the command line
    folder: Path  # of the results


def main(config: EvaluateConfig) -> Evaluation:
    """Evaluates, writes the files and prints the table."""
    task = prepare(config)
    doing(COMPILING)
    sizes = config.episodes, config.seed, config.num_lots, config.horizon
    result = evaluate(task.env, task.policy, *sizes)
    report(config, task, result)
    return result


def prepare(config: EvaluateConfig) -> Task:
    """Finds policy and environment, and checks the folder."""
    name = config.run
    driver = find_driver(name, config.environment, not config.stochastic)
    changed = adapted(config, driver.env, metrics=MetricsConfig.everything())
    env = ParkingEnv(changed)
    policy = driver.policy(env)  # what is refused until here leaves no folder
    same = dataclasses.replace(changed, metrics=driver.env.metrics) == driver.env
    asked = any(getattr(config, x) != getattr(EvaluateConfig, x) for x in TASK)
    kept = Path(name) if Path(name).parent.name == "checkpoints" else None
    folder = driver.folder
    if asked or kept or not same:
        folder /= subfolder(config, kept)
    folder = Path(config.out) if config.out else folder
    # Refused before the work.
    require_writable(folder / "evaluation.csv", new_folders=True)
    return Task(name, policy, env, folder)


def subfolder(config: EvaluateConfig, kept: Path | None = None) -> Path:
    """Subfolder of other evaluations, named by their flags and a kept checkpoint."""
    changes = [kept.stem] if kept else []
    changes += [
        f"{field.name}-{'+'.join(value) if isinstance(value, tuple) else value}"
        for field in dataclasses.fields(config)
        if (value := getattr(config, field.name)) != field.default
        and field.name not in UNNAMED
    ]
    name = urllib.parse.quote("_".join(changes), safe=",:=+")
    if len(name) > MAX_NAME:
        digest = hashlib.sha256(name.encode()).hexdigest()[:8]
        name = f"{name[: MAX_NAME - 9]}-{digest}"
    return Path("evaluations") / name


def report(config: EvaluateConfig, task: Task, result: Evaluation) -> None:
    """Writes the files and prints the table."""
    env = task.env.config
    counts, rule = env.agent_counts, env.episode.parked_rule
    fewest, most = counts[0], counts[-1]
    agents = f"{fewest} to {most}" if fewest < most else f"{most}"
    title = (
        f"{task.name}: {agents} agent{'s' * (most > 1)}, {rule} rule, "
        f"{env.layout} lot, {env.physics} physics, seed {config.seed}"
    )
    settings = {**dataclasses.asdict(config), "policy": task.name}
    task.folder.mkdir(parents=True, exist_ok=True)
    written = write_evaluation(task.folder, result, settings)
    print_report(result, title)
    made, asked = len(result.episodes), config.episodes
    if config.horizon is None and made > asked:
        drivers = len({(row["lot"], row["agent"]) for row in result.episodes})
        each = f"{made // drivers} by each of {drivers} agents"
        print(f"{made:,} episodes: {each} ({asked:,} asked for, rounded up)")
    lots = len({row["lot"] for row in result.episodes})
    if lots < config.num_lots != EvaluateConfig.num_lots:
        print(f"{lots:,} lots: episodes fill no more ({config.num_lots:,} asked for)")
    print(f"wrote {', '.join(map(str, written))}")
