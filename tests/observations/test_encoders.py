"""Encoders from outside: what they must say, and what the environment does with it."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import cars, lot
from helpers.sliding import SlidePhysics, placed
from helpers.states import config_of, state_of

from carpark_mj.config import ENCODERS, EnvConfig, FleetConfig, ObservationConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.goals import tracks
from carpark_mj.mdp.parked_cars import tracks_parked_cars
from carpark_mj.observations import Field, make_fields, observe
from carpark_mj.policy.runs import from_dict

LOT = lot([(0.0, 0.0, 0.0)])


@dataclasses.dataclass(frozen=True)
class Speedometer(ObservationConfig):
    """Own speed now and one step ago.

    Attributes:
        scale: of the speeds [m/s].
        encoding: fixed.
    """

    scale: float = 5.0
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


@pytest.fixture
def speedometer(monkeypatch):
    """It has a name, until the test ends."""
    monkeypatch.setitem(ENCODERS._parts, "speedometer", Speedometer)


def test_an_encoder_of_its_own_fills_the_vector_and_remembers():
    config = EnvConfig(num_agents=2, num_parked_cars=0, observation=Speedometer())
    env = ParkingEnv(config, SlidePhysics())
    state, first = jax.jit(env.reset)(jax.random.key(0))
    assert first.shape == (2, env.observation_size) == (2, 2)
    np.testing.assert_array_equal(first[:, 1], 0.0)
    state = placed(env, state, [[-4.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    step, ahead = jax.jit(env.step), jnp.array([[0.0, 1.0], [0.0, 0.5]])
    state, one = step(state, ahead)
    _, two = step(state, jnp.zeros((2, 2)))
    speed = np.asarray(one.motion.speed) / 5.0
    assert (speed > 0.0).all()
    np.testing.assert_array_equal(one.observation[:, 0], speed)
    np.testing.assert_array_equal(two.observation[:, 1], speed)
    # Whoever begins a new episode has no past.
    late = jnp.array([config.episode.max_steps, 0], jnp.int32)
    _, timestep = step(state.replace(step=late), ahead)
    assert timestep.events.done.tolist() == [True, False]
    np.testing.assert_array_equal(timestep.observation[:, 1], [0.0, speed[1]])


def test_what_an_encoder_does_not_say_is_no():
    seen = Speedometer()
    assert not seen.sees_own_car
    assert not seen.sees_routes
    assert not seen.sees_everywhere
    config = config_of(seen)
    state = state_of(LOT, cars(np.zeros((3, 3))), 0)
    assert not tracks(config, state).any()
    assert not tracks_parked_cars(config, state).any()
    with pytest.raises(ValueError, match=r"fleet.agents needs observation.own_car"):
        EnvConfig(observation=seen, fleet=FleetConfig(("city",)))


def test_an_encoder_is_read_back_by_its_name(speedometer):
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
        ("ab", {"a": (3, 1)}, r"'wrong' does not fill \['b'\]"),
        ("a", {"a": (3, 1), "c": (3, 1)}, r"'wrong' fills \['c'\], which it does not"),
        ("ab", {"a": (3,), "b": (3, 1)}, r"'wrong' fills \['a'\] with \[\(3,\)\]"),
        ("ab", {"a": (3, 2), "b": (3, 1)}, r"\['a'\] with \[\(3, 2\)\] .*\(3, 1\)"),
        ("aba", {"a": (3, 1), "b": (3, 1)}, r"'wrong' declares \['a'\] twice"),
    ],
)
def test_values_that_are_not_those_of_the_fields_are_refused(names, filled, message):
    config = config_of(encoder(names, filled))
    state = state_of(LOT, cars(np.zeros((3, 3))), 0)
    with pytest.raises(ValueError, match=message) as caught:
        jax.eval_shape(lambda state: observe(config, state), state)
    assert "\n" not in str(caught.value)


def test_fields_in_the_order_of_the_declaration():
    config = config_of(encoder("ba", {"a": (3, 1), "b": (3, 1)}))
    assert [field.name for field in make_fields(config)] == ["b", "a"]
