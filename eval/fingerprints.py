"""Fingerprints of every environment: digests of resets, steps and observations.

A refactoring must not change them. Two checkouts are compared on one machine, as
rounding differs between processors and versions of XLA:

    python eval/fingerprints.py --out before.json    # in the old checkout
    python eval/fingerprints.py --against before.json

Environments are stepped with random actions for fixed keys; those with tyres on both
steppers of the physics. `--only` names some of them.
"""

import argparse
import dataclasses
import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.registry import ENVIRONMENTS

STEPS = 8
OPTIONS: Any = {"xla_backend_optimization_level": 1}


def configs() -> dict[str, EnvConfig]:
    """Every environment by name; `name/mjx` is stepped by `mjx.step`."""
    found = {"default": EnvConfig(), **ENVIRONMENTS}
    mjx = {
        f"{name}/mjx": dataclasses.replace(
            config, sim=dataclasses.replace(config.sim, stepper="mjx")
        )
        for name, config in found.items()
        if config.physics_config.back_end == "mjx"
    }
    return found | mjx


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


def main() -> int:
    """Prints what differs; exit code 1 if anything does."""
    parser = argparse.ArgumentParser(description="Digests of every environment")
    parser.add_argument("--out", type=Path, help="file for the digests")
    parser.add_argument("--against", type=Path, help="file of another checkout")
    parser.add_argument("--only", nargs="*", help="environments")
    options = parser.parse_args()
    known = json.loads(options.against.read_text()) if options.against else {}
    found: dict[str, dict[str, str]] = {}
    wrong = 0
    for name, config in sorted(configs().items()):
        if options.only and name not in options.only:
            continue
        found[name] = fingerprint(config)
        old = known.get(name, {})
        other = [part for part in found[name] if found[name][part] != old.get(part)]
        wrong += bool(known and other)
        verdict = f"differs: {', '.join(other)}" if other else "equal"
        print(f"{name:24} {verdict if known else found[name]['steps']}", flush=True)
        if options.out:
            options.out.write_text(json.dumps(found, indent=1) + "\n")
    return min(wrong, 1)


if __name__ == "__main__":
    sys.exit(main())
