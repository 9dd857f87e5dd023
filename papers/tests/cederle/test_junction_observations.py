"""The vector by hand."""

import dataclasses

import jax
import jax.numpy as jnp
import junctions
import numpy as np
import pytest

from carpark_papers.cederle.junction.observations import FAR, observe

ENV = junctions.env(scenario="2av-hd")
seen_in = jax.jit(observe)


def test_numbers_are_those_of_the_study_in_its_order():
    """Agent 1 at (-20, -1.65), 8.54 m on, to (38.22, -1.65), others 5 and 10 m away."""
    poses = [[-17.0, 2.35, np.pi], [-20.0, -1.65, 0.5], [-12.0, -7.65, 0.0]]
    state = junctions.with_poses(junctions.begin(ENV), poses)
    state = dataclasses.replace(state, along=jnp.array([0.0, 18.54, 0.0]))
    expected = [-58.22, 0.0, 58.22, -3.0, -4.0, -8.0, 6.0, 5.0, 10.0]
    expected += [13.89, 0.0, np.cos(0.5), np.sin(0.5), 8.54]
    np.testing.assert_allclose(seen_in(state)[1], expected, atol=1e-4)


def test_a_car_that_has_left_is_far_away():
    state = junctions.begin(ENV)
    state = dataclasses.replace(state, present=jnp.array([True, True, False]))
    seen = seen_in(state)[0]
    np.testing.assert_allclose(seen[5:7], FAR)
    assert float(seen[8]) == pytest.approx(FAR * 2**0.5)
    assert abs(float(seen[3])) < 80


@pytest.mark.parametrize(
    ("name", "size"), [("2av", 11), ("2av-hd", 14), ("3av", 14), ("3av-hd", 17)]
)
def test_sizes_are_those_of_the_study(name, size):
    assert junctions.env(scenario=name).observation_shape == (size,)
