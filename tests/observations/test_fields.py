"""Fields of observations, sets of entities, and encoders from outside."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.observing import BAYS, CONFIGS, observed
from helpers.scenes import cars, fields_of, lot
from helpers.sliding import POSES, placed, sliding
from helpers.states import config_of, state_of

from carpark_mj.config import (
    ENCODERS,
    EnvConfig,
    EpisodeConfig,
    FleetConfig,
    GoalConfig,
    ObservationConfig,
    RayConfig,
    ShareConfig,
    UltrasoundConfig,
)
from carpark_mj.config.networks import NetworkConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import to_local
from carpark_mj.layouts import layout_config
from carpark_mj.layouts.types import mirror
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.mdp.goals import tracks
from carpark_mj.mdp.parked_cars import tracks_parked_cars
from carpark_mj.observations import (
    ContinuousObservation,
    make_fields,
    observation_size,
    observe,
)
from carpark_mj.observations.compose import OWN, observation_sets
from carpark_mj.observations.ego import TURNS
from carpark_mj.observations.fields import ASIDE, FAR, FARTHEST, NEAR, Field
from carpark_mj.policy.networks import make_finish
from carpark_mj.policy.runs import from_dict
from carpark_mj.registry import ANYWHERE, environment
from carpark_mj.spawning.reset_options import ResetOptions


@pytest.mark.parametrize("config", CONFIGS)
def test_the_table_of_fields_describes_the_whole_vector(config):
    fields = make_fields(config_of(config))
    names = [field.name for field in fields]
    assert len(set(names)) == len(names)
    assert sum(field.size for field in fields) == observation_size(config_of(config))
    assert all(field.low < field.high and field.meaning for field in fields)
    # `observed` asserts that the vector is as long as the table says.
    named = observed(config, BAYS, cars([(0.0, 0.0, 0.0)] * 2), [0, 1], [2])
    assert list(named) == names


def test_ranges_hold_in_lots_larger_than_they_are():
    """Two agents and all bays half a kilometre away from a third agent."""
    config = ContinuousObservation(2, 2, share=ShareConfig(goals=True))
    far_apart = cars([(0.0, 0.0, 0.4), (400.0, -400.0, 0.0), (300.0, 500.0, 1.0)])
    bays = [(500.0 + 5.0 * k, 300.0, 0.0) for k in range(4)]
    fields = {field.name: field for field in make_fields(config_of(config))}
    beyond = 0
    for name, value in observed(config, lot(bays), far_apart, [0, 1, 2], [3]).items():
        field = fields[name]
        assert (value >= field.low).all(), name
        assert (value <= field.high).all(), name
        beyond += (np.abs(value) == FARTHEST).any()
    assert beyond >= 4


def test_by_default_all_lots_lie_within_the_ranges():
    """So nothing is cut off in them."""
    most = 0.0
    for layout in ANYWHERE.layout.split(","):
        config = layout_config(layout)
        keys = jax.random.split(jax.random.key(0), 200)
        lots = jax.jit(jax.vmap(config.generate))(keys)
        across = 2.0 * np.linalg.norm(lots.extent, axis=-1)
        most = max(most, float(across.max()))
    assert 80.0 < most < FAR * FARTHEST


@pytest.mark.parametrize(
    ("num_agents", "num_parked_cars", "slots"),
    [(9, 5, (6, 4)), (7, 4, (6, 4)), (6, 3, (5, 3)), (2, 1, (1, 1)), (1, 0, (1, 1))],
)
def test_slots_are_as_many_as_cars_and_at_least_one(num_agents, num_parked_cars, slots):
    config = EnvConfig(num_agents=num_agents, num_parked_cars=num_parked_cars)
    names = {field.name for field in make_fields(config)}
    for kind, count in zip(("agent", "parked_car"), slots, strict=True):
        assert f"{kind}_{count - 1}_present" in names
        assert f"{kind}_{count}_present" not in names
    assert ContinuousObservation() == ContinuousObservation(6, 4, rays=RayConfig(24))


FIXED = EnvConfig(num_agents=4, num_parked_cars=5)
CONFIGS_OF_SETS = {
    "fixed": FIXED,
    "alone": EnvConfig(num_agents=1, num_parked_cars=0),
    "blind": dataclasses.replace(
        FIXED, observation=ContinuousObservation(tracked_agents=0)
    ),
    "dynamic": dataclasses.replace(
        FIXED,
        goals=GoalConfig(True, 3),
        observation=ContinuousObservation(tracked_movers=2),
    ),
}


@pytest.mark.parametrize("name", CONFIGS_OF_SETS)
def test_every_number_goes_to_the_entity_that_its_field_names(name):
    fields = make_fields(CONFIGS_OF_SETS[name])
    sets = observation_sets(fields)
    vector = jnp.arange(2 * sets.size).reshape(2, sets.size)  # each number is its place
    parts = {k: np.asarray(part) for k, part in sets.split(vector).items()}
    wanted = {OWN: []}
    start = 0
    for field in fields:
        numbers = list(range(start, start + field.size))
        start += field.size
        if not field.group:
            wanted[OWN] += numbers
            continue
        entities = wanted.setdefault(field.group, [])
        if field.index == len(entities):
            entities.append([])
        entities[field.index] += numbers
    assert start == sets.size
    assert sets.own_size == len(wanted[OWN])
    assert set(parts) == set(wanted)
    for part, expected in wanted.items():
        for row in (0, 1):
            expected_row = np.array(expected) + row * sets.size
            np.testing.assert_array_equal(parts[part][row], expected_row)


def test_entities_are_present_where_their_mask_is_1_or_missing():
    fields = make_fields(CONFIGS_OF_SETS["dynamic"])
    sets = observation_sets(fields)
    counts = {part.group: part.count for part in sets.sets}
    assert counts == {"bay": 3, "agent": 3, "parked_car": 4, "mover": 2}
    masks, vector, start = {}, np.full(sets.size, 0.7, np.float32), 0
    for field in fields:
        if field.is_mask:
            bit = len(masks) % 3 == 0
            masks[field.group, field.index] = bit
            vector[start] = bit
        start += field.size
    present = sets.present(sets.split(jnp.asarray(vector)))
    for (group, index), bit in masks.items():
        assert present[group][index] == bit
    assert sum(map(len, present.values())) == len(masks)
    assert 0 < sum(masks.values()) < len(masks)
    # Without a mask they always are.
    cars = [Field("car_x", 1, -1, 1, "", "car", index) for index in range(3)]
    sets = observation_sets([Field("speed", 1, -1, 1, ""), *cars])
    present = sets.present(sets.split(jnp.zeros((2, sets.size))))
    np.testing.assert_array_equal(present["car"], np.ones((2, 3), bool))


def test_agents_remember_when_and_where_they_turned():
    observation = dataclasses.replace(POSES, own_past=True)
    config = EnvConfig(num_agents=2, num_parked_cars=0, observation=observation)
    env, reset, step = sliding(config)
    state, _ = reset(jax.random.key(0))
    state = placed(env, state, [[-4.0, 0.0, 0.3], [4.0, 0.0, 0.0]])
    turns = []
    for k, pedal in enumerate((1, -1, -1, 1, -1, 0, -1, 1, -1, 1, 0, 0)):
        state, timestep = step(state, jnp.array([[0.4, pedal], [0.0, 0.0]]))
        seen = fields_of(timestep.observation, config)
        known = [to_local(state.motion.pose_w[0], pose) for pose in turns[::-1][:TURNS]]
        wanted = np.zeros((TURNS, 4))
        for row, (x, y, yaw) in zip(wanted, known, strict=False):
            row[:] = x / (2 * NEAR), y / (2 * NEAR), np.cos(yaw), np.sin(yaw)
        assert np.abs(wanted[:, :2]).max() < 1.0
        np.testing.assert_allclose(
            seen["own_turns"][0].reshape(TURNS, 4), wanted, atol=1e-5
        )
        np.testing.assert_allclose(seen["own_changes"][:, 0], [len(turns) / 20, 0.0])
        np.testing.assert_allclose(seen["own_time"][:, 0], 0.2 * (k + 1) / 100)
        if k in (1, 3, 4, 7, 8, 9):  # of the past from the next step on
            turns.append(state.motion.pose_w[0])
    # The last step is not of the past yet, but the cars stood before the first.
    rests = seen["own_time"][:, 1] * 10 / 0.2
    np.testing.assert_allclose(rests, [1, 12], rtol=1e-6)
    late = jnp.array([config.episode.max_steps, 0], jnp.int32)
    _, timestep = step(state.replace(step=late), jnp.zeros((2, 2)))
    seen = fields_of(timestep.observation, config)
    for name in ("own_time", "own_changes", "own_turns"):
        np.testing.assert_array_equal(seen[name][0], 0.0)


@dataclasses.dataclass(frozen=True)
class Speedometer(ObservationConfig):
    """Own speed now and one step ago."""

    scale: float = 5.0  # m/s
    encoding: str = "speedometer"

    def fields(self, env):
        return [
            Field("speed", 1, -2.0, 2.0, "now"),
            Field("speed_before", 1, -2.0, 2.0, "a step ago"),
        ]

    def values(self, env, state):
        now = state.motion.speed[:, None] / self.scale
        return {"speed_before": state.memory["speed"], "speed": now}

    def init_memory(self, env):
        return {"speed": jnp.zeros((env.num_agents, 1))}

    def remember(self, state):
        return {"speed": state.motion.speed[:, None] / self.scale}


def test_an_encoder_of_its_own_fills_the_vector_and_remembers():
    config = EnvConfig(num_agents=2, num_parked_cars=0, observation=Speedometer())
    env, reset, step = sliding(config)
    state, first = reset(jax.random.key(0))
    assert first.shape == (2, env.observation_size) == (2, 2)
    np.testing.assert_array_equal(first[:, 1], 0.0)
    state = placed(env, state, [[-4.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    ahead = jnp.array([[0.0, 1.0], [0.0, 0.5]])
    state, one = step(state, ahead)
    _, two = step(state, jnp.zeros((2, 2)))
    speed = np.asarray(one.motion.speed) / 5.0
    assert (speed > 0.0).all()
    np.testing.assert_array_equal(one.observation[:, 0], speed)
    np.testing.assert_array_equal(two.observation[:, 1], speed)
    # An agent that begins a new episode has no past.
    late = jnp.array([config.episode.max_steps, 0], jnp.int32)
    _, timestep = step(state.replace(step=late), ahead)
    assert timestep.events.done.tolist() == [True, False]
    np.testing.assert_array_equal(timestep.observation[:, 1], [0.0, speed[1]])


def test_what_an_encoder_does_not_say_is_no():
    state = state_of(lot([(0.0, 0.0, 0.0)]), cars(np.zeros((3, 3))), 0)
    for which in (tracks, tracks_parked_cars):
        assert not which(config_of(Speedometer()), state).any()
    with pytest.raises(ValueError, match=r"fleet.agents needs observation.own_car"):
        EnvConfig(observation=Speedometer(), fleet=FleetConfig(("city",)))


def test_an_encoder_is_read_back_by_its_name(monkeypatch):
    monkeypatch.setitem(ENCODERS._parts, "speedometer", Speedometer)
    config = EnvConfig(observation=Speedometer(scale=3.0))
    data = json.loads(json.dumps(dataclasses.asdict(config)))
    assert from_dict(EnvConfig, data) == config
    data["observation"]["reach"] = 1.0
    with pytest.raises(ValueError, match="Speedometer setting 'reach'"):
        from_dict(EnvConfig, data)
    data["observation"] = {"encoding": "images"}
    with pytest.raises(ValueError, match="unknown observation encoding 'images'"):
        from_dict(EnvConfig, data)


def encoder(names, filled):
    """An encoder that declares and fills fields of one number, or of given shapes."""

    @dataclasses.dataclass(frozen=True)
    class Wrong(Speedometer):
        encoding: str = "wrong"

        def fields(self, env):
            return [Field(name, 1, 0.0, 1.0, "") for name in names]

        def values(self, env, state):
            return {name: jnp.zeros(shape) for name, shape in filled.items()}

    return Wrong()


@pytest.mark.parametrize(
    ("names", "filled", "message"),
    [
        ("ab", {"a": (3, 1)}, r"'wrong' must .* b: \(3, 1\), None"),
        ("a", {"a": (3, 1), "c": (3, 1)}, r"'wrong' must .* c: None, \(3, 1\)"),
        ("ab", {"a": (3, 2), "b": (3, 1)}, r"'wrong' must .* a: \(3, 1\), \(3, 2\)"),
        ("aba", {"a": (3, 1), "b": (3, 1)}, r"'wrong' must declare each field once"),
    ],
)
def test_values_that_are_not_those_of_the_fields_are_refused(names, filled, message):
    config = config_of(encoder(names, filled))
    state = state_of(lot([(0.0, 0.0, 0.0)]), cars(np.zeros((3, 3))), 0)
    with pytest.raises(ValueError, match=message):
        jax.eval_shape(lambda state: observe(config, state), state)


def test_a_mirrored_lot_is_seen_as_the_fields_say():
    """Two cars drive the mirror image of the same ways."""
    seen = ContinuousObservation(
        *(1, 2),
        **dict.fromkeys(("route", "lines", "own_gear", "own_past"), True),
        rays=RayConfig(8, near=1.0),
        ultrasound=UltrasoundConfig(on=True, noise=0.0),
        share=ShareConfig(speeds=True, goals=True, steering=True),
    )
    stays = EpisodeConfig(respawn=False)
    base = EnvConfig(layout="street", physics="bicycle", num_parked_cars=3)
    config = dataclasses.replace(base, observation=seen, episode=stays)
    env, key = ParkingEnv(config), jax.random.key(3)
    layout, side = env.draw_layout(key), jnp.array([1.0, -1.0, -1.0])
    pose, goal = jnp.array([[-4.0, 1.0, 0.3], [5.0, -1.0, 2.8]]), jnp.array([1, 6])
    ways = jnp.array([[0.8, 0.9], [-0.5, 0.7], [-0.5, -1.0], [1.0, -0.8]])

    @jax.jit
    def drive(layout, pose, turn):
        options = ResetOptions(pose=pose, goal=goal)
        state, _ = env.reset_to_layout(layout, key, options=options)
        actions = jnp.repeat(ways, 4, axis=0)[:, None] * jnp.array([turn, 1.0])
        drive = jax.lax.scan(env.step, state, jnp.repeat(actions, 2, axis=1))
        return drive[1].observation.reshape(-1, env.observation_size)

    here, there = drive(layout, pose, 1.0), drive(mirror(layout), pose * side, -1.0)
    asked = []
    mirrored = NetworkConfig(bins=3, mirrored=True)
    finish = make_finish(mirrored, make_fields(config), ActionSpec(2))
    logits = jnp.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    found = finish(lambda x: asked.append(x) or logits, here)
    np.testing.assert_allclose(asked[1], there, atol=2e-4)
    assert (np.abs(here - there).max(axis=0) > 0.01).mean() > 0.3
    np.testing.assert_allclose(found, [1.0, 1.0, 1.0, 3.0, 4.0, 5.0])  # either steer


def test_points_and_directions_have_a_mirror_image():
    for field in make_fields(environment("valet")):
        if field.size == 2:  # other pairs are lengths and limits
            assert (field.mirror == ASIDE) == (field.low < 0.0), field.name
