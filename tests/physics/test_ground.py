"""Ground as a function, against tilted gravity and against conservation of energy."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.oracle import CCar

from carpark_mj.config import SimConfig
from carpark_mj.physics import MjxPhysics
from carpark_mj.physics.ground import from_height, ground_frames, plane, upright
from carpark_mj.vehicle import COMPACT, Vehicle
from carpark_mj.vehicle.parameters import GRAVITY

GRADE = 0.12
FAR = 100.0  # m, where the slope ends and the ramp is
# Level, then a smooth knee at x = 8 m into 6 %.
GROUND = from_height(
    lambda xy: jnp.where(
        xy[1] < FAR / 2,
        GRADE * xy[0],
        0.06 * jax.nn.softplus(4.0 * (xy[0] - 8.0)) / 4.0,
    )
)


@pytest.fixture(scope="module")
def drive(compact: Vehicle):
    """Drives on `GROUND`, compiled once; controls (35, 2).

    Returns states read after each step (T, ...), and the heights of the rear axle.
    """
    physics = MjxPhysics(SimConfig(), GROUND)

    def step(state, control):
        state = physics.step(state, control)
        return state, (physics.read(state), state.qpos[2])

    run = jax.jit(lambda state, controls: jax.lax.scan(step, state, controls)[1])

    def drive(pose, controls):
        state = physics.init(jnp.array(pose, jnp.float32), compact)
        return jax.device_get(run(state, jnp.asarray(controls, jnp.float32)))

    return drive


def test_frames_are_rotations_that_tilt_without_yaw():
    _, normal = plane(0.3, -0.2)(jnp.zeros((5, 2)))
    frames = np.asarray(ground_frames(normal))
    for frame in frames:
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-6)
        np.testing.assert_allclose(frame[:, 2], normal[0], atol=1e-6)
        assert np.linalg.det(frame) == pytest.approx(1.0, abs=1e-6)
        assert frame[0, 1] == frame[1, 0]  # no yaw
    level = np.asarray(ground_frames(jnp.array([[0.0, 0.0, 1.0]])))
    np.testing.assert_array_equal(level[0], np.eye(3))


def test_a_height_function_gives_its_gradient_as_normal():
    ground = from_height(lambda xy: 0.1 * xy[0] ** 2 - 0.2 * xy[1])
    height, normal = ground(jnp.array([[2.0, 1.0]]))
    assert height[0] == pytest.approx(0.2)
    expected = np.array([-0.4, 0.2, 1.0]) / math.sqrt(1.2)
    np.testing.assert_allclose(normal[0], expected, rtol=1e-6)


def test_an_upright_car_has_the_asked_heading_and_stands_on_the_slope():
    _, normal = plane(0.3, -0.2)(jnp.zeros((1, 2)))
    for yaw in (-3.0, -1.0, 0.0, 0.5, 2.5):
        w, x, y, z = (float(q) for q in upright(normal[0], jnp.array(yaw)))
        up = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
        np.testing.assert_allclose(up, normal[0], atol=1e-6)
        ahead = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z)]
        assert math.atan2(ahead[1], ahead[0]) == pytest.approx(yaw, abs=1e-6)


def test_a_plane_is_the_same_as_tilted_gravity(drive):
    yaw = 0.4
    controls = np.repeat([[0, 0], [0.5, 1.0], [-0.7, -0.4]], [5, 8, 22], axis=0)
    sim = SimConfig(grade_x=GRADE)
    car = CCar(COMPACT, (0.0, 0.0, yaw), sim)  # in C MuJoCo, on tilted gravity
    rates = []
    for steer, pedal in controls[:20]:
        for _ in range(sim.num_substeps):
            car.step(steer, pedal)
        w, _, _, z = car.data.qpos[3:7]
        ahead = 2 * math.atan2(z, w)
        way = np.array([math.cos(ahead), math.sin(ahead)])
        x, y = car.data.qvel[:2]
        rates.append([way @ (x, y), way[0] * y - way[1] * x, car.data.qvel[5]])
    # The same heading within the slope, seen from above.
    plan = math.atan2(math.sin(yaw), math.cos(yaw) / math.hypot(1.0, GRADE))
    slope = drive((0.0, 0.0, plan), controls)[0]
    assert np.abs(rates)[:, 0].max() > 1.0
    # float32 along two ways of computing 4 s.
    found = np.column_stack([slope.velocity_b, slope.yaw_rate])[:20]
    np.testing.assert_allclose(found, rates, atol=2e-3)


def test_coasting_up_a_ramp_trades_speed_for_height(drive):
    controls = np.repeat([[0.0, 1.0], [0.0, 0.0]], [15, 20], axis=0)
    seen, height = drive((0.0, FAR, 0.0), controls)
    start, end = 15, 30
    v0, v1 = seen.speed[start], seen.speed[end]
    spinning = 4 * COMPACT.wheel_inertia / COMPACT.wheel_radius**2 / COMPACT.mass
    way = seen.pose_w[end, 0] - seen.pose_w[start, 0]
    climbed = 0.06 * COMPACT.cg_to_rear_axle + height[end] - height[start]
    kinetic = (1 + spinning) * (v0**2 - v1**2) / 2
    potential = GRAVITY * climbed
    rolling = COMPACT.tyre.rolling_resistance * GRAVITY * way
    assert height[end] > 0.1
    assert v1 > 0.5
    assert kinetic == pytest.approx(potential + rolling, rel=0.03)


def test_a_ground_and_a_grade_exclude_each_other():
    with pytest.raises(ValueError, match=r"either a ground or grades.*0\.1"):
        MjxPhysics(SimConfig(grade_x=0.1), plane(0.1, 0.0))
