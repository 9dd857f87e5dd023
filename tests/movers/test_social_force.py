"""The social force model against cases worked out by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import crowds
from carpark_mj.movers import bodies as model
from carpark_mj.movers.bodies import Room, go_round

WEIDMANN = {1.0: 1.06, 2.0: 0.61}  # m/s at persons/m², of one-way flow
EAST = jnp.array([[1.0, 0.0]])


def test_a_person_alone_reaches_the_desired_speed_with_the_relaxation_time():
    velocity, nothing = jnp.zeros((1, 2)), jnp.zeros((1, 2))
    for step in range(1, 11):  # any step size gives the exact solution
        velocity = model.accelerate(velocity, 1.34 * EAST, nothing, 0.2)
        expected = 1.34 * (1 - np.exp(-0.2 * step / model.RELAXATION))
        np.testing.assert_allclose(velocity, [[expected, 0.0]], atol=1e-5)


def potential(x, y, stride):
    """V(b) of equation 3, for a step of a given length to the east."""
    far = np.hypot(x - stride, y)
    b = 0.5 * np.sqrt((np.hypot(x, y) + far) ** 2 - stride**2)
    return model.STRENGTH * np.exp(-b / model.RANGE)


@pytest.mark.parametrize(("x", "y", "speed"), [(0.8, 0.3, 0.0), (-0.5, 0.9, 0.7)])
def test_the_force_is_the_slope_of_the_potential(x, y, speed):
    # The first person looks at the second, so that sight weakens nothing.
    away = np.array([[-x, -y], [speed, 0.0]])
    heading = away / np.maximum(np.linalg.norm(away, axis=1), 1e-9)[:, None]
    offset = jnp.array([[0.0, x], [-x, 0.0]]), jnp.array([[0.0, y], [-y, 0.0]])
    fx, fy = model.push(offset, jnp.array([0.0, speed]), jnp.array(heading))
    stride, eps = speed * model.STEP_TIME, 1e-5
    slope_x = potential(x + eps, y, stride) - potential(x - eps, y, stride)
    slope_y = potential(x, y + eps, stride) - potential(x, y - eps, stride)
    expected = -np.array([slope_x, slope_y]) / (2 * eps)
    np.testing.assert_allclose([fx[0, 1], fy[0, 1]], expected, rtol=1e-3)


def test_two_who_meet_push_each_other_alike_and_mirrored_crowds_stay_mirrored():
    # Farther apart than a step of 2.6 m, within which the ellipse is a line.
    offset = jnp.array([[0.0, -4.0], [4.0, 0.0]]), jnp.zeros((2, 2))
    fx, fy = model.push(offset, jnp.full(2, 1.3), jnp.array([[1.0, 0], [-1.0, 0]]))
    np.testing.assert_allclose(fx[0, 1], -fx[1, 0], rtol=1e-5)
    assert fx[0, 1] < 0.0
    np.testing.assert_allclose(fy, 0.0, atol=1e-6)
    rng = np.random.default_rng(0)
    xy, way = rng.normal(size=(2, 6, 2))
    way /= np.linalg.norm(way, axis=1)[:, None]

    def force(flip):
        there, heading = xy * [1, flip], jnp.array(way * [1, flip])
        offset = jnp.moveaxis(jnp.array(there[:, None] - there), -1, 0)
        found = model.push((offset[0], offset[1]), jnp.full(6, 1.3), heading)
        return np.stack(found, -1) * [1, flip] * ~np.eye(6, dtype=bool)[..., None]

    np.testing.assert_allclose(force(1), force(-1), rtol=1e-4, atol=1e-6)


def test_what_is_behind_counts_less_and_coinciding_people_stay_finite():
    offset = jnp.array([[1.0]]), jnp.array([[0.0]])
    [[seen]], _ = model.push(offset, jnp.zeros(1), -EAST)
    [[unseen]], _ = model.push(offset, jnp.zeros(1), EAST)
    assert float(unseen / seen) == pytest.approx(model.UNSEEN)
    zero = jnp.zeros((1, 1)), jnp.zeros((1, 1))
    assert np.isfinite(model.push(zero, jnp.ones(1), EAST)).all()
    assert np.isfinite(model.border_push(zero)).all()
    assert np.linalg.norm(model.limit(9.0 * EAST, jnp.ones(1))) == pytest.approx(1.3)


@pytest.mark.parametrize("density", WEIDMANN)
def test_crowds_walk_as_fast_as_published_at_any_period(density, monkeypatch):
    monkeypatch.setattr(crowds, "ONE_WAY", (8.0, 3.0))
    monkeypatch.setattr(crowds, "ONE_WAY_TIME", 12.0)
    walk = jax.jit(crowds.one_way, static_argnums=(1, 2, 3))
    slow, fast = (walk(jax.random.key(0), density, 0.2, dt) for dt in (0.2, 0.04))
    assert float(slow) == pytest.approx(WEIDMANN[density], rel=0.25)
    assert float(fast) == pytest.approx(float(slow), rel=0.25)


def test_person_who_touches_a_body_slides_along_it():
    angle = jnp.linspace(0.0, 2 * jnp.pi, 200)
    ahead = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)
    right = jnp.stack([ahead[:, 1], -ahead[:, 0]], axis=1)
    room = Room(ahead[:, :1], ahead[:, 1:], jnp.zeros((200, 1)))
    move = jax.jit(go_round)([room], 0.12 * ahead + 0.16 * right)
    assert (move * right).sum(axis=1).min() > 0.16
    np.testing.assert_allclose((move * ahead).sum(axis=1), 0.0, atol=1e-6)
