"""Updates of PPO from the same steps on 1, 2 and 4 devices.

Run with `JAX_NUM_CPU_DEVICES=4`, a variant and the path of an `.npz` file, which then
holds what was learned: arrays named `devices/number`, and losses.
"""

import dataclasses
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from helpers.programs import ROOT, python
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, PartitionSpec

from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations.compose import ObservationSets
from carpark_mj.observations.fields import Field
from carpark_mj.policy.networks import NetworkConfig, init_normalizer, make_networks
from carpark_mj.training.ppo.collect import AXIS, Rollout
from carpark_mj.training.ppo.learn import learn, network_params
from carpark_mj.training.ppo.parts import PRESETS

LENGTH, AGENTS, SIZE = 8, 8, 4
DEVICES = (1, 2, 4)
# Actions and a preset of each variant; `ml-agents` is of carpark_papers.
ACTIONS = {"brax": ActionSpec(2), "ml-agents": ActionSpec(0, (3, 2))}
PRESET = {"brax": "cpu", "ml-agents": "tanner-fixed-original"}
# Present; of the first two devices one has two of four, the other all; a quarter has
# none at all.
PRESENT = np.array([1, 1, 0, 0, 1, 1, 1, 1], np.float32)


def made_up(variant: str) -> Rollout:
    """Steps (LENGTH, AGENTS), most of those truncated of the last agents."""
    rng = np.random.default_rng(0)
    shape = (LENGTH, AGENTS)

    def normal(*size: int) -> jax.Array:
        return jnp.asarray(rng.normal(size=(*shape, *size)), jnp.float32)

    ends = rng.random(shape) < np.linspace(0.0, 0.5, AGENTS)
    raw_action = normal(2)
    if variant == "ml-agents":
        raw_action = jnp.asarray(rng.integers(0, 2, (*shape, 2)), jnp.int32)
    return Rollout(
        observation=normal(SIZE),
        raw_action=raw_action,
        log_prob=-2.0 + 0.1 * normal(),
        reward=normal() + jnp.linspace(0.0, 3.0, AGENTS),
        terminated=jnp.zeros(shape),
        truncated=jnp.asarray(ends, jnp.float32),
        final_observation=normal(SIZE)[0],
        weight=jnp.broadcast_to(PRESENT, shape) if variant == "brax" else None,
    )


def learned(variant: str, count: int) -> tuple[Any, dict[str, jax.Array]]:
    """What `learn` makes of the steps, which so many devices share."""
    config = dataclasses.replace(
        PRESETS[PRESET[variant]],
        num_minibatches=1,  # the same steps, whatever their order
        num_epochs=3,
        entropy_cost=0.0,  # it is sampled
        entropy_cost_end=0.0,
    )
    networks = make_networks(
        NetworkConfig((16,), (16,), encoder="flat"),
        [Field("x", SIZE, -1.0, 1.0, "")],
        ACTIONS[variant],
    )
    params = network_params(
        networks.policy_network.init(jax.random.key(0)),
        networks.value_network.init(jax.random.key(1)),
    )
    optimizer, inputs = optax.scale_by_adam(), ObservationSets(SIZE)
    state = SimpleNamespace(
        update=jnp.int32(0),
        seconds=jnp.float32(0.0),
        normalizer=init_normalizer(inputs),
        policy=params.policy,
        value=params.value,
        optimizer=optimizer.init(ravel_pytree(params)[0]),
    )
    rollout, whole = made_up(variant), PartitionSpec()
    agents: Any = PartitionSpec(None, AXIS)
    specs = jax.tree.map(lambda _: agents, rollout)
    specs = dataclasses.replace(specs, final_observation=PartitionSpec(AXIS))

    def update(rollout: Rollout) -> Any:
        key = jax.random.key(2)
        given = cast(Any, state)
        return learn(config, networks, inputs, optimizer, given, rollout, key)

    split = jax.shard_map(
        update,
        mesh=Mesh(np.array(jax.devices()[:count]), (AXIS,)),
        in_specs=(specs,),
        out_specs=whole,
        check_vma=False,
    )
    return jax.jit(split)(rollout)


def learned_by(variant: str, path: Path) -> dict[str, np.ndarray]:
    """What all numbers of devices learn, in a process with four, by `devices/what`."""
    paths = os.pathsep.join(str(ROOT / name) for name in ("", "tests", "papers"))
    environment = {"JAX_NUM_CPU_DEVICES": "4", "PYTHONPATH": paths}
    done = python(__file__, variant, path, **environment)
    assert done.returncode == 0, done.stderr
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def assert_alike(found: dict[str, np.ndarray]) -> None:
    """Asserts that several devices learn what one learns."""
    names = [name[2:] for name in found if name.startswith("1/")]
    assert "policy_loss" in names
    for name in names:
        for count in DEVICES[1:]:
            # Sums in another order; the steps of Adam are of 1e-4 and 1e-3.
            np.testing.assert_allclose(
                found[f"{count}/{name}"],
                found[f"1/{name}"],
                rtol=2e-5,
                atol=2e-6,
                err_msg=name,
            )


def main(variant: str, path: str) -> None:
    """Writes what comes of a variant on all numbers of devices."""
    arrays = {}
    for count in DEVICES:
        (normalizer, policy, value, _), losses = learned(variant, count)
        leaves = jax.tree.leaves((normalizer, policy, value))
        arrays |= {f"{count}/{k}": np.asarray(x) for k, x in enumerate(leaves)}
        # Not the extremes of distributions, which are means over the devices.
        arrays |= {
            f"{count}/{key}": np.asarray(x)
            for key, x in losses.items()
            if "_dist_" not in key
        }
    np.savez(path, **arrays)


if __name__ == "__main__":
    main(*sys.argv[1:])
