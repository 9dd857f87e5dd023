"""`carpark_mj record`: episodes of a policy as data to learn from."""

import dataclasses
import hashlib
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.cli.clock import COMPILING, doing
from carpark_mj.cli.driver import adapted, find_driver
from carpark_mj.cli.settings.driving import RecordConfig
from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import require_unset
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.evaluator import CHUNK
from carpark_mj.extensions import require_packages
from carpark_mj.files import require_writable, write_atomically, write_json
from carpark_mj.play.demonstration import STEPS, load_demonstration
from carpark_mj.policy.acting import AnyPolicy, Carry, Step, acts, as_argument, roll_out
from carpark_mj.policy.runs import CONFIG_VERSION
from carpark_mj.wrappers.gymnasium_env import one_agent
from carpark_mj.wrappers.options import share

ID = "carpark_mj/Park-v0"  # repeats every episode, with the config of the recording
ROOT = "MINARI_DATASETS_PATH"  # where Minari looks for data sets


class Episode(NamedTuple):
    """An episode of `t` steps of the environment `ID` reset with `seed`."""

    seed: int | None  # None of a person's, who began elsewhere
    observations: Any  # (t + 1, ...), or a dictionary of arrays
    actions: np.ndarray  # (t, size)
    rewards: np.ndarray  # (t,) float32
    terminations: np.ndarray  # (t,) bool
    truncations: np.ndarray  # (t,) bool
    infos: dict[str, np.ndarray]  # (t + 1, ...) `pose`, `is_success`, `crashed`


def record(
    env: ParkingEnv,
    policy: AnyPolicy,
    seeds: Sequence[int],
    num_lots: int = 64,
    noise: float = 0.0,
) -> Iterator[Episode]:
    """Drives an episode for each seed, `num_lots` side by side.

    Args:
        env: of one agent, without respawn.
        policy: what drives.
        seeds: of `reset`, in [0, 2**32).
        num_lots: simulated at once; the last ones are filled up.
        noise: standard deviation of normal noise on steer and pedal.
    """
    kind, numbers = env.action_spec.dtype, env.action_spec.continuous

    def drive(policy: AnyPolicy, carry: Carry, keys: jax.Array) -> Any:
        choose = acts(policy)

        def act(state: Any, observation: Any, memory: Any, key: jax.Array) -> Any:
            action, memory = choose(state, observation, memory, key)
            if numbers:
                draw = jax.random.normal(jax.random.fold_in(key, 1), action.shape)
                action = jnp.clip(action + noise * draw, -1.0, 1.0)
            return action.astype(kind), memory

        return roll_out(env, act, carry, keys, report)

    def report(step: Step) -> dict[str, Any]:
        made = step.timestep
        return {
            "observations": env.unpack(made.observation),
            "actions": step.action,
            "rewards": made.reward,
            "terminations": made.terminated,
            "truncations": made.truncated,
            "infos": {
                "pose": made.motion.pose_w,
                "is_success": made.events.success,
                "crashed": made.events.crashed,
            },
        }

    reset = jax.jit(jax.vmap(lambda seed: env.reset(jax.random.key(seed))))
    chunk, policy = jax.jit(drive), as_argument(policy)
    for first in range(0, len(seeds), num_lots):
        group = seeds[first : first + num_lots]
        state, seen = reset(np.resize(np.array(group, np.uint32), num_lots))
        carry, ended, chunks = Carry(state, seen), np.zeros(num_lots, bool), list[Any]()
        key, no = jax.random.key(group[0]), np.zeros((num_lots, 1), bool)
        infos = {"pose": state.motion.pose_w, "is_success": no, "crashed": no}
        begun = {"observations": env.unpack(seen), "infos": infos}
        begun = jax.tree.map(lambda x: np.asarray(x)[None], begun)
        while not ended.all():
            keys = jax.random.split(jax.random.fold_in(key, len(chunks)), CHUNK)
            carry, made = chunk(policy, carry, keys)
            chunks.append(jax.device_get(made))
            done = chunks[-1]["terminations"] | chunks[-1]["truncations"]
            ended |= done.any(axis=(0, 2))
        steps = _join(*chunks)
        steps |= {name: _join(x, steps[name]) for name, x in begun.items()}
        done = (steps["terminations"] | steps["truncations"])[:, :, 0]
        for lot, seed in enumerate(group):
            end = int(np.argmax(done[:, lot])) + 1
            own = jax.tree.map(lambda x: x[: end + 1, lot, 0], steps)  # noqa: B023
            short = {name: own[name][:end] for name in steps if name not in begun}
            yield Episode(int(seed), **(own | short))


def driven(paths: Sequence[Path]) -> tuple[EnvConfig, list[Episode]]:
    """The environment of drives that `play` has saved, and their whole episodes.

    Raises:
        ValueError: not of one agent, of different environments, or without an end.
    """
    drives = [load_demonstration(path) for path in paths]
    config, *others = (drive.config for drive in drives)
    if config.num_agents != 1 or any(other != config for other in others):
        raise ValueError(
            f"drives must be of one agent in one environment, not those in "
            f"{paths[0].parent}"
        )
    unpack, found = ParkingEnv(config).unpack, list[Episode]()
    for drive in drives:
        own = {name: getattr(drive, name)[:, 0] for name in STEPS}
        begin = 0
        for end in np.flatnonzero(own["terminated"] | own["truncated"]) + 1:
            step = {name: array[begin:end] for name, array in own.items()}
            ends = (
                np.append(False, step["terminated"]),
                np.append(False, step["success"]),
            )
            infos = {"is_success": ends[1], "crashed": ends[0] & ~ends[1]}
            infos["pose"] = np.append(step["poses"][:1], step["next_poses"], axis=0)
            seen = np.append(
                step["observations"][:1], step["next_observations"], axis=0
            )
            seen = jax.tree.map(np.asarray, unpack(jnp.asarray(seen)))
            paid = step["actions"], step["rewards"]
            ended = step["terminated"], step["truncated"]
            found.append(Episode(None, seen, *paid, *ended, infos))
            begin = end
    if not found:
        raise ValueError(f"no episode has ended in the drives in {paths[0].parent}")
    return config, found


def _join(*trees: Any) -> Any:
    return jax.tree.map(lambda *parts: np.concatenate(parts), *trees)


def transitions(episodes: Sequence[Episode]) -> dict[str, np.ndarray]:
    """Arrays with a row for every step, and the number of its `episode`.

    Dictionaries of observations become an array each, as `observations.vector`.
    """
    rows: list[dict[str, Any]] = []
    for number, episode in enumerate(episodes):
        seen = episode.observations
        parts = seen if isinstance(seen, dict) else {"": seen}
        parts = {f"observations.{k}".rstrip("."): x for k, x in parts.items()}
        row = {name: x[:-1] for name, x in parts.items()}
        row |= {f"next_{name}": x[1:] for name, x in parts.items()}
        names = ("actions", "rewards", "terminations", "truncations")
        row |= {name: getattr(episode, name) for name in names}
        row |= {name: x[1:] for name, x in episode.infos.items()}
        rows.append(row | {"episode": np.full(len(episode.rewards), number)})
    return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}


def main(config: RecordConfig) -> Path:
    """Records, writes and prints; returns the folder."""
    folder, drives = Path(config.out), sorted(Path(config.run).glob("drive-*.npz"))
    if drives:
        others = {x.name for x in dataclasses.fields(config)} - {"run", "out", "minari"}
        require_unset(config, "with drives", *others)
        settings, episodes = driven(drives)
    else:
        driver = find_driver(config.run, config.environment)
        settings = adapted(config, driver.env, num_agents=1)
        env = share(ParkingEnv, one_agent(settings))
        seeds = range(config.seed, config.seed + config.episodes)
        policy = driver.policy(env)
        episodes = record(env, policy, seeds, config.num_lots, config.noise)
    made = gymnasium.make(ID, config=settings)
    words = (config.environment or "park", config.run.partition(":")[2] or config.run)
    words = [re.sub(r"\W+", "-", Path(word).stem).strip("-") for word in words]
    name = f"carpark_mj/{words[0]}/{words[1]}-v0"
    if config.minari:
        require_packages("minari")
        if (folder / name).exists():
            raise ValueError(f"{folder / name} exists: choose another folder")
    require_writable(folder / "episodes.npz", new_folders=True)  # before the work
    if not drives:
        doing(COMPILING)
    episodes = list(episodes)
    arrays = transitions(episodes)
    found = hashlib.sha256(b"".join(x.tobytes() for x in arrays.values())).hexdigest()
    parked = float(arrays["is_success"].sum() / len(episodes))
    about = {
        "recording": dataclasses.asdict(config),
        "environment": {"id": ID, "config": dataclasses.asdict(settings)},
        "config_version": CONFIG_VERSION,
        "device": jax.devices()[0].device_kind,
        "steps": len(arrays["rewards"]),
        "parked": parked,
        "sha256": found,
    }
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "episodes.npz"
    columns: Any = arrays  # no other argument
    write_atomically(file, lambda path: np.savez_compressed(path, **columns))
    write_json(folder / "recording.json", about)
    if config.minari:
        from minari import create_dataset_from_buffers
        from minari.data_collector import EpisodeBuffer

        os.environ[ROOT] = str(folder.resolve())  # Minari has no argument for it
        buffers: Any = [EpisodeBuffer(**episode._asdict()) for episode in episodes]
        with warnings.catch_warnings():  # of authors that are not named
            warnings.simplefilter("ignore")
            create_dataset_from_buffers(name, buffers, made)
    made.close()
    print(
        f"{len(episodes):,} episodes, {about['steps']:,} steps, {parked:.1%} parked, "
        f"SHA-256 {found}\nwrote {folder}" + f", data set {name}" * config.minari
    )
    return folder
