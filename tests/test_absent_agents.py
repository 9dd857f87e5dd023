"""Lots that have fewer agents than they could: the absent leave no trace."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    GivingWayConfig,
    GoalConfig,
    JitterConfig,
    MetricsConfig,
    RayConfig,
    RingConfig,
    SensorConfig,
    ShareConfig,
    SimConfig,
    SpawnConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.observations import ContinuousObservation, make_fields
from carpark_mj.types import NO_BAY, State, TimeStep

PRESENT = 2
MOST = 5
EVERYTHING = MetricsConfig(driving=True, safety=True)
FIXED = EnvConfig(
    num_agents=MOST,
    physics="bicycle",
    occupancy=(0.2, 0.4),
    jitter=JitterConfig(heading=(-0.1, 0.1)),
    sensors=SensorConfig(position_noise=0.05, delay_max=1),
    episode=EpisodeConfig(max_steps=25, final_observation=True),
    observation=ContinuousObservation(
        tracked_agents=4,
        rays=RayConfig(8),
        rings=RingConfig((4.0, 8.0), history=1),
        share=ShareConfig(speeds=True, goals=True),
        global_information=True,
    ),
    metrics=EVERYTHING,
)
DYNAMIC = dataclasses.replace(
    FIXED,
    goals=GoalConfig(dynamic=True),
    giving_way=GivingWayConfig(scheme="G,G,S"),
    spawn=SpawnConfig(close_ratio=0.3, conflict_ratio=0.3, relocation="random"),
)


def without_absent(state: State, count: int) -> State:
    """The state of a lot in which only the first agents exist."""
    names = ("physics", "motion", "goal", "tracked_bays", "memory", "step")
    names = (*names, "active", "stats", "sensors")
    own = {
        name: jax.tree.map(lambda x: x[:count], getattr(state, name)) for name in names
    }
    return dataclasses.replace(state, present=None, **own)


def fewer_slots(timestep: TimeStep, env: ParkingEnv, small: ParkingEnv) -> TimeStep:
    """What agents get, in the slots of a smaller environment; all others are empty."""
    names = {field.name for field in make_fields(small.config)}
    kept = [
        field.name in names
        for field in make_fields(env.config)
        for _ in range(field.size)
    ]
    seen = timestep.observation
    assert not np.any(seen[:, ~np.array(kept)])
    final = timestep.final_observation
    return dataclasses.replace(
        timestep,
        observation=seen[:, np.array(kept)],
        final_observation=None if final is None else final[:, np.array(kept)],
    )


def park_first(env: ParkingEnv, state: State) -> State:
    """The state with its first agent standing in its goal, or in a bay it tracks."""
    goal = state.goal
    if state.tracked_bays is not None:
        goal = goal.at[0].set(state.tracked_bays[0, 0])
    pose = state.motion.pose_w.at[0].set(state.layout.bay_pose[goal[0]])
    first = jnp.arange(env.num_agents) == 0
    vehicle = state.physics.vehicle
    physics = env.physics.place(state.physics, first, pose, vehicle)
    return dataclasses.replace(
        state, goal=goal, physics=physics, motion=env.physics.read(physics)
    )


def standing(env: ParkingEnv) -> jax.Array:
    """Actions (num_agents, size) of cars at rest that stay there with their goals."""
    spec = env.action_spec
    return jnp.zeros((env.num_agents, spec.size)).at[:, 2:].set(99)


def random_action(env: ParkingEnv, rng: np.random.Generator) -> jax.Array:
    """Random actions (num_agents, size), of physical cars ahead with a goal kept."""
    spec, shape = env.action_spec, (env.num_agents,)
    driving = [rng.uniform(-1, 1, shape), np.full(shape, 0.7)]
    choices = [np.where(rng.random(shape) < 0.2, 1, 99) for _ in spec.choices]
    return jnp.asarray(np.stack([*driving, *choices], -1), jnp.float32)


@pytest.mark.parametrize(
    "name", ["dynamic", pytest.param("fixed", marks=pytest.mark.slow)]
)
def test_agents_drive_as_if_the_absent_did_not_exist(name):
    env = ParkingEnv({"fixed": FIXED, "dynamic": DYNAMIC}[name])
    alone = ParkingEnv(dataclasses.replace(env.config, num_agents=PRESENT))
    reset, step, step_alone = map(jax.jit, (env.reset, env.step, alone.step))
    park = jax.jit(lambda state: park_first(env, state))
    rng, parked, crashed = np.random.default_rng(1), 0, 0
    state, _ = reset(jax.random.key(5), num_present=jnp.int32(PRESENT))
    for k in range(80):
        action = random_action(env, rng)
        if k % 20 == 19:
            state, action = park(state), standing(env)
        # Every step on its own, for rounding must not add up.
        lot = without_absent(state, PRESENT)
        state, timestep = step(state, action)
        lot, expected = step_alone(lot, action[:PRESENT])
        timestep, expected = jax.device_get((timestep, expected))
        own = jax.tree.map(lambda x: x[:PRESENT], timestep)
        own = fewer_slots(own, env, alone)
        found = without_absent(state, PRESENT)
        for (path, a), b in zip(
            jax.tree.leaves_with_path((own, found)),
            jax.tree.leaves((expected, lot)),
            strict=True,
        ):
            if jnp.issubdtype(a.dtype, jax.dtypes.prng_key):
                a, b = jax.random.key_data(a), jax.random.key_data(b)
            np.testing.assert_allclose(a, b, atol=1e-4, rtol=1e-4, err_msg=str(path))
        absent = jax.tree.map(lambda x: x[PRESENT:], timestep)
        for part in (absent.events, absent.reward_terms, absent.observation):
            assert not any(np.any(x) for x in jax.tree.leaves(part))
        parked += int(own.events.parked.sum())
        crashed += int(own.events.crashed.sum())
    assert min(parked, crashed) > 0


@pytest.mark.parametrize(
    "physics", ["mjx", pytest.param("scene", marks=pytest.mark.slow)]
)
def test_absent_agents_stand_far_apart_and_see_zeros(physics):
    config = EnvConfig(
        num_agents=4,
        num_parked_cars=2,
        physics=physics,
        sim=SimConfig(sim_dt=0.02, grade_x=0.1),
        sensors=SensorConfig(position_noise=0.1),
        episode=EpisodeConfig(max_steps=30),
        metrics=EVERYTHING,
    )
    env = ParkingEnv(config)
    state, observation = jax.jit(env.reset)(jax.random.key(0), num_present=jnp.int32(1))
    first, rng = state.motion.pose_w[1:], np.random.default_rng(0)
    actions = jnp.stack([random_action(env, rng) for _ in range(20)])
    steps = 12 if physics == "scene" else 500  # slow

    def step(state, k):
        state, timestep = env.step(state, actions[k % 20])
        return state, (timestep, state.motion)

    state, (timestep, motion) = jax.jit(
        lambda state: jax.lax.scan(step, state, jnp.arange(steps))
    )(state)
    assert not np.any(observation[1:])
    assert not np.any(timestep.observation[:, 1:])
    assert not np.any(timestep.reward[:, 1:])
    assert not np.any(timestep.events.done[:, 1:])
    assert np.any(timestep.events.done[:, 0]) == (steps == 500)
    for leaf in jax.tree.leaves((timestep, motion)):
        assert np.isfinite(leaf).all()
    # Contacts let go of the brake: a car may roll by what float32 cannot tell.
    moved = np.abs(motion.pose_w[:, 1:] - first).max()
    assert moved <= (0.01 if physics == "scene" else 0.0)
    xy = np.concatenate([state.motion.xy[1:], state.parked_cars.pose_w[:, :2]])
    gap = np.linalg.norm(xy[:, None] - xy, axis=-1) + 1e9 * np.eye(len(xy))
    assert gap[:3].min() > 15.0
    assert np.linalg.norm(xy[:3], axis=-1).min() > 5000.0


def test_the_number_of_agents_is_uniform_and_they_are_the_first():
    env = ParkingEnv(dataclasses.replace(DYNAMIC, min_agents=2))
    lots = 4000
    state, _ = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(1), lots))
    assert state.present is not None
    present = np.asarray(state.present)
    counts = np.bincount(present.sum(axis=1), minlength=MOST + 1)
    share = 1 / 4
    assert counts[:2].sum() == 0
    spread = 4 * np.sqrt(lots * share * (1 - share))
    assert np.abs(counts[2:] - lots * share).max() < spread
    assert (present[:, :-1] >= present[:, 1:]).all()
    np.testing.assert_array_equal(state.active, present)
    assert (np.asarray(state.goal)[~present] == NO_BAY).all()
