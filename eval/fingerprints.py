"""Fingerprints of every environment: digests of resets, steps and observations.

A refactoring must not change them. Two checkouts are compared on one machine, as
rounding differs between processors and versions of XLA:

    python eval/fingerprints.py --out before.json    # in the old checkout
    python eval/fingerprints.py --against before.json

Environments are stepped with random actions for fixed keys; those with tyres on both
steppers of the physics. `--only` names some of them.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("fingerprints", "fingerprints:main")

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import CheckedConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.files import write_json
from carpark_mj.reading import read_object
from carpark_mj.registry import ENVIRONMENTS
from shell import command

STEPS = 8
OPTIONS: Any = {"xla_backend_optimization_level": 1}


def configs() -> dict[str, EnvConfig]:
    """Every environment by name; `name/mjx` is stepped by `mjx.step`."""
    found = {"default": EnvConfig(), **ENVIRONMENTS}
    for name, config in [*found.items()]:
        if config.physics_config.back_end == "mjx":
            sim = dataclasses.replace(config.sim, stepper="mjx")
            found[f"{name}/mjx"] = dataclasses.replace(config, sim=sim)
    return found


def digest(tree: Any) -> str:
    """Digest of the values of a pytree, by their paths; typed keys by their data."""
    sha = hashlib.sha256()
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
            leaf = jax.random.key_data(leaf)
        sha.update(f"{jax.tree_util.keystr(path)}{leaf.dtype}{leaf.shape}".encode())
        sha.update(np.ascontiguousarray(leaf).tobytes())
    return sha.hexdigest()[:16]


def fingerprint(config: EnvConfig) -> dict[str, str]:
    """Digests of a reset, of `STEPS` steps and of their observations."""
    env = ParkingEnv(config)
    state, observation = jax.jit(env.reset, compiler_options=OPTIONS)(jax.random.key(7))
    found = {"reset": digest(state), "observation": digest(observation)}
    size = (STEPS, config.num_agents, env.action_spec.size)
    actions = jax.random.uniform(jax.random.key(8), size, minval=-1.0)

    @jax.jit
    def play(state: Any) -> Any:
        return jax.lax.scan(env.step, state, actions)

    state, steps = play.lower(state).compile(compiler_options=OPTIONS)(state)
    return {**found, "state": digest(state), "steps": digest(steps)}


@dataclasses.dataclass(frozen=True)
class FingerprintsConfig(CheckedConfig):
    """Settings of the fingerprints.

    Attributes:
        out: file for the digests; empty = none.
        against: file of another checkout; empty = none.
        only: names of environments; empty = all.
    """

    out: str = ""
    against: str = ""
    only: tuple[str, ...] = ()


def compare(config: FingerprintsConfig) -> int:
    """Prints what differs; exit code 1 if anything does."""
    known = read_object(Path(config.against)) if config.against else {}
    found: dict[str, dict[str, str]] = {}
    envs, wrong = configs(), False
    for name in sorted({*envs} & {*(config.only or envs)}):
        new = found[name] = fingerprint(envs[name])
        other = [part for part in new if new[part] != known.get(name, {}).get(part)]
        wrong |= bool(known and other)
        verdict = f"differs: {', '.join(other)}" if other else "equal"
        print(f"{name:24} {verdict if known else new['steps']}", flush=True)
        if config.out:
            write_json(Path(config.out), found)
    return int(wrong)


main = command(FingerprintsConfig, compare, __doc__)
