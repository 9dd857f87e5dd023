"""Updates of PPO from the same steps on 1, 2 and 4 devices.

Run with `JAX_NUM_CPU_DEVICES=4` and a variant; it asserts that they are alike.
"""

import dataclasses
import os
import sys

import jax
import jax.numpy as jnp
import numpy as np
import optax
from helpers.learning import begun, rollout
from helpers.programs import ROOT, python
from jax.sharding import Mesh, PartitionSpec

from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations.compose import ObservationSets
from carpark_mj.observations.fields import Field
from carpark_mj.policy.networks import NetworkConfig, make_networks
from carpark_mj.training.ppo.collect import AXIS
from carpark_mj.training.ppo.learn import learn
from carpark_mj.training.ppo.parts import PRESETS

LENGTH, AGENTS, SIZE = 8, 8, 4
# Actions and a preset of each variant; `ml-agents` is of carpark_papers.
ACTIONS = {"brax": ActionSpec(2), "ml-agents": ActionSpec(0, (3, 2))}
PRESET = {"brax": "cpu", "ml-agents": "tanner-fixed-original"}
# Present; of the first two devices one has two of four, the other all; a quarter has
# none at all.
PRESENT = np.array([1, 1, 0, 0, 1, 1, 1, 1], np.float32)


def made_up(variant):
    """Steps (LENGTH, AGENTS), most of those truncated of the last agents."""
    rng = np.random.default_rng(0)
    shape = (LENGTH, AGENTS)

    def normal(*size):
        return jnp.asarray(rng.normal(size=(*shape, *size)), jnp.float32)

    ends = rng.random(shape) < np.linspace(0.0, 0.5, AGENTS)
    raw_action = normal(2)
    if variant == "ml-agents":
        raw_action = jnp.asarray(rng.integers(0, 2, (*shape, 2)), jnp.int32)
    return rollout(
        shape,
        observation=normal(SIZE),
        raw_action=raw_action,
        log_prob=-2.0 + 0.1 * normal(),
        reward=normal() + jnp.linspace(0.0, 3.0, AGENTS),
        truncated=jnp.asarray(ends, jnp.float32),
        final_observation=normal(SIZE)[0],
        weight=jnp.broadcast_to(PRESENT, shape) if variant == "brax" else None,
    )


def learned(variant, count):
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
    inputs = ObservationSets(SIZE)
    parts = config, networks, inputs, optax.scale_by_adam()
    state, steps = begun(networks, inputs, jax.random.key(0)), made_up(variant)
    specs = jax.tree.map(lambda _: PartitionSpec(None, AXIS), steps)
    split = jax.shard_map(
        lambda steps: learn(*parts, state, steps, jax.random.key(2)),
        mesh=Mesh(np.array(jax.devices()[:count]), (AXIS,)),
        in_specs=(dataclasses.replace(specs, final_observation=PartitionSpec(AXIS)),),
        out_specs=PartitionSpec(),
        check_vma=False,
    )
    (*networks, _), losses = jax.jit(split)(steps)
    # Not the extremes of distributions, which are means over the devices.
    return networks, {k: x for k, x in losses.items() if "_dist_" not in k}


def assert_alike(variant):
    """Asserts in a process with four devices that these learn what one learns."""
    paths = os.pathsep.join(str(ROOT / name) for name in ("", "tests", "papers"))
    given = {"JAX_NUM_CPU_DEVICES": "4", "PYTHONPATH": paths}
    done = python(__file__, variant, **given)
    assert done.returncode == 0, done.stderr


if __name__ == "__main__":
    one, *others = (learned(sys.argv[1], count) for count in (1, 2, 4))
    assert "policy_loss" in one[1]
    for found in others:
        # Sums in another order; the steps of Adam are of 1e-4 and 1e-3.
        jax.tree.map(
            lambda a, b: np.testing.assert_allclose(a, b, rtol=2e-5, atol=2e-6),
            found,
            one,
        )
