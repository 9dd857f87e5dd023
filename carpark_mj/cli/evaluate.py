"""`carpark_mj evaluate`: whole episodes on held-out seeds, reported."""

import dataclasses
import hashlib
import urllib.parse
from pathlib import Path

from carpark_mj.cli.clock import COMPILING, doing
from carpark_mj.cli.driver import adapted, find_driver
from carpark_mj.cli.settings.driving import EvaluateConfig
from carpark_mj.config import EnvConfig, MetricsConfig
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


def main(config: EvaluateConfig) -> Evaluation:
    """Evaluates, writes the files and prints the table."""
    env, policy, folder = prepare(config)
    doing(COMPILING)
    sizes = config.episodes, config.seed, config.num_lots, config.horizon
    result = evaluate(env, policy, *sizes)
    report(config, env.config, folder, result)
    return result


def prepare(config: EvaluateConfig) -> tuple[ParkingEnv, AnyPolicy, Path]:
    """The environment with the flags' changes, the policy, the folder of results."""
    driver = find_driver(config.run, config.environment, not config.stochastic)
    changed = adapted(config, driver.env, metrics=MetricsConfig.everything())
    env = ParkingEnv(changed)
    policy = driver.policy(env)  # what is refused until here leaves no folder
    same = dataclasses.replace(changed, metrics=driver.env.metrics) == driver.env
    asked = any(getattr(config, x) != getattr(EvaluateConfig, x) for x in TASK)
    run = Path(config.run)
    kept = run if run.parent.name == "checkpoints" else None
    folder = driver.folder
    if asked or kept or not same:
        folder /= subfolder(config, kept)
    folder = Path(config.out) if config.out else folder
    # Refused before the work.
    require_writable(folder / "evaluation.csv", new_folders=True)
    return env, policy, folder


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


def report(
    config: EvaluateConfig, env: EnvConfig, folder: Path, result: Evaluation
) -> None:
    """Writes the files and prints the table."""
    counts, rule = env.agent_counts, env.episode.parked_rule
    fewest, most = counts[0], counts[-1]
    agents = f"{fewest} to {most}" if fewest < most else f"{most}"
    title = (
        f"{config.run}: {agents} agent{'s' * (most > 1)}, {rule} rule, "
        f"{env.layout} lot, {env.physics} physics, seed {config.seed}"
    )
    settings = {**dataclasses.asdict(config), "policy": config.run}
    folder.mkdir(parents=True, exist_ok=True)
    written = write_evaluation(folder, result, settings)
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
