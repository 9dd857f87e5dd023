"""The examples of docs/extending.md run, and do what the page says of them."""

import re
import sys
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.registering import restore_after
from helpers.scenes import cars, polygons
from helpers.sliding import SlidePhysics

from carpark_mj.cli.evaluate import EvaluateConfig
from carpark_mj.config import (
    ENCODERS,
    ENDS,
    METRICS,
    MOVERS,
    PARKED_RULES,
    PHYSICS,
    REWARD_TERMS,
    EnvConfig,
    MetricsConfig,
    RewardConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import DesignCar, make_layout
from carpark_mj.layouts.base import FAMILIES, LAYOUTS
from carpark_mj.layouts.checks import describe_faults
from carpark_mj.mdp.terminations import is_parked
from carpark_mj.observations import make_fields
from carpark_mj.rendering.stage import Stage
from carpark_mj.scene.car_mesh import car_meshes
from carpark_mj.scene.parts import shape_name
from carpark_mj.vehicle import COMPACT, PRESETS, VEHICLES, make_vehicle

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "extending.md").read_text()
PACKAGES = ROOT / "examples" / "extensions"
SECTIONS = {
    section.split("\n", 1)[0]: section
    for section in re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:]
}


def block(name, language):
    """The only block of code of a section in a language."""
    [found] = re.findall(rf"^```{language}\n(.*?)^```", SECTIONS[name], re.M | re.S)
    return found


def run(name):
    """What the example of a section defines."""
    names = {"__name__": "example"}
    exec(block(name, "python"), names)
    return names


@pytest.fixture(autouse=True)
def registries(monkeypatch):
    """What examples register is gone after each test."""
    restore_after(monkeypatch, ENCODERS, FAMILIES, LAYOUTS, MOVERS, PHYSICS, VEHICLES)
    restore_after(monkeypatch, PARKED_RULES, REWARD_TERMS, METRICS, ENDS)


def test_every_lot_of_the_new_family_is_valid():
    config = run("A layout")["CourtConfig"]()
    make = jax.jit(config.generate)
    lots = [make(jax.random.key(number)) for number in range(20)]
    assert not any(describe_faults(lot, DesignCar().size) for lot in lots)
    assert {int(lot.bay_mask.sum()) for lot in lots} == {6, 7, 8, 9, 10}


@pytest.mark.parametrize(
    ("section", "name"),
    [
        ("A layout", "court"),
        ("A metric", "peak_lateral"),
        ("An observation field", "nearest_wall"),
    ],
)
def test_the_page_shows_the_packages_as_they_are(section, name):
    code = (PACKAGES / name / f"{name}.py").read_text().partition("\n\n\n")[2]
    assert code
    assert code in block(section, "python")


def test_new_reward_terms_and_metrics_are_those_of_packages():
    run("A metric")
    exec((PACKAGES / "haste" / "haste.py").read_text())
    reward = RewardConfig(extra={"haste": 0.01})
    metrics = MetricsConfig(extra=("peak_lateral",))
    env = ParkingEnv(EnvConfig(num_agents=2, reward=reward, metrics=metrics))
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    step = jax.jit(env.step)
    for _ in range(20):
        state, timestep = step(state, jnp.array([[0.3, 1.0], [0.0, 0.0]]))
    # One drives, one is at rest: haste is paid alone, the metric is the largest so far.
    haste, speed = timestep.reward_terms["haste"], np.abs(timestep.motion.speed)
    assert speed[0] > 1.5 > speed[1]
    np.testing.assert_allclose(haste, [-0.01 * (speed[0] - 1.5), 0.0], rtol=1e-6)
    total = sum(timestep.reward_terms.values())
    np.testing.assert_allclose(timestep.reward, total, atol=1e-6)
    now = np.abs(timestep.motion.yaw_rate * timestep.motion.speed)
    peak = np.asarray(timestep.metrics["peak_lateral"])
    assert peak[0] >= now[0] > 0.1
    assert peak[1] == pytest.approx(0.0, abs=1e-3)


def test_the_new_field_is_observed_at_reset_and_in_steps():
    run("An observation field")
    observation = ENCODERS["nearest_wall"]()
    env = ParkingEnv(EnvConfig(num_agents=2, observation=observation), SlidePhysics())
    assert make_fields(env.config)[:-1] == make_fields(EnvConfig(num_agents=2))
    state, first = jax.jit(env.reset)(jax.random.key(0))
    _, timestep = jax.jit(env.step)(state, jnp.ones((2, 2)))
    for seen, motion in (
        (first, state.motion),
        (timestep.observation, timestep.motion),
    ):
        walls = polygons(state.layout.wall_pose, state.layout.wall_size)
        centres = shapely.points(np.asarray(motion.xy))
        nearest = shapely.distance(centres[:, None], walls).min(axis=1)
        np.testing.assert_allclose(20.0 * seen[:, -1], nearest, atol=1e-4)


def test_the_new_mover_comes_and_goes():
    names = run("A mover")
    env, state = names["env"], names["state"]

    @jax.jit
    def drive(state):
        def step(state, _):
            state, _ = env.step(state, jnp.zeros((2, 2)))
            return state, jnp.stack([group.mask[0] for group in state.movers.groups])

        return jax.lax.scan(step, state, length=100)[1]  # two periods

    np.testing.assert_array_equal(drive(state).sum(axis=0), [50, 50])


def test_the_new_vehicle_drives_alone_in_a_fleet_and_is_drawn():
    names = run("A vehicle")
    state, _ = jax.jit(names["env"].reset)(jax.random.key(0))
    assert state.physics.vehicle.wheelbase == pytest.approx(2.7)
    taxi, mixed = names["taxi"], names["mixed"]
    assert mixed.fleet.agents == (taxi, PRESETS["city"])
    stage = Stage(make_layout("square"), mixed.vehicle, 2, 1, mixed.fleet.agents)
    meshes = map(stage.model.mesh, range(stage.model.nmesh))
    drawn = [mesh.name.partition("/")[0] for mesh in meshes]
    assert shape_name(taxi) in drawn
    length, width, _ = np.ptp(car_meshes(taxi)["body"].bounds, axis=0)
    assert length == pytest.approx(taxi.length, abs=0.05)
    assert width == pytest.approx(taxi.width, abs=0.01)


def test_the_new_back_end_follows_its_controls_with_a_lag(monkeypatch):
    monkeypatch.syspath_prepend(PACKAGES / "hover")
    names = run("A physics back end")
    sys.modules.pop("hover")
    env, lag = names["env"], names["HoverConfig"]().lag
    still = env.physics.init(jnp.zeros((2, 3)), make_vehicle(COMPACT))
    slide, spin = jnp.array([0.0, 0.5, 0.0]), jnp.array([1.0, 0.0, 0.5])
    state = still
    for step in range(1, 11):
        state = env.physics.step(state, jnp.stack([slide, spin]))
        t = 0.2 * step
        rise = 1.0 - np.exp(-t / lag)
        motion = env.physics.read(state)
        np.testing.assert_allclose(motion.pose_w[0, 1], t - lag * rise, atol=1e-5)
        np.testing.assert_allclose(motion.pose_w[0, ::2], 0.0, atol=1e-6)
        np.testing.assert_allclose(motion.yaw_rate, [0.0, 0.4 * rise], atol=1e-6)
    # Steadily turning ahead it flies a circle of speed over yaw rate.
    x, y, yaw = np.asarray(motion.trace_w[1], float).T
    turned = np.diff(yaw).sum()
    chord = np.hypot(x[-1] - x[0], y[-1] - y[0])
    assert chord / (2 * np.sin(turned / 2)) == pytest.approx(2.0 / 0.4, rel=1e-3)
    assert env.action_spec.size == 3
    assert names["timestep"].motion.velocity_b[0, 1] > 0.5


def test_the_new_parked_rule_holds_with_straight_wheels_only():
    env = run("A parked rule")["env"]
    rule, size = env.config.episode.parked_rule, jnp.array([5.0, 2.5])
    motion = cars(np.zeros((2, 3)), steering=[0.0, 0.1])
    assert is_parked(rule, motion, jnp.zeros(3), size).tolist() == [True, False]
    assert EvaluateConfig(run="square", rule=rule).rule == "straight"


def test_the_new_end_truncates_beyond_its_distance():
    config = run("Another end")["env"].config.episode
    [end] = (ENDS[name] for name in config.ends)
    state = SimpleNamespace(motion=cars([(14.9, 0.0, 0.0), (-15.1, 0.0, 0.0)]))
    assert end.test(state).tolist() == [False, True]
    assert end.outcome == "timed_out"
