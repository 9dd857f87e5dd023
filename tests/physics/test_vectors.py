import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from carpark_mj.physics import coordinates as vectors

RNG = np.random.default_rng(0)


def random_quaternions(count: int) -> np.ndarray:
    q = RNG.normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def components(a: np.ndarray) -> tuple:
    """The components of vectors (n, k) as a tuple of arrays (n,)."""
    return tuple(jnp.array(a[:, k]) for k in range(a.shape[1]))


def stacked(a) -> np.ndarray:
    return np.stack([np.asarray(x) for x in a], -1)


@pytest.mark.parametrize(
    ("ours", "numpys"),
    [
        (vectors.add, np.add),
        (vectors.subtract, np.subtract),
        (vectors.cross, np.cross),
    ],
    ids=["add", "subtract", "cross"],
)
def test_vector_operations_are_numpys(ours, numpys):
    a, b = RNG.normal(size=(2, 50, 3))
    found = stacked(ours(components(a), components(b)))
    assert found == pytest.approx(numpys(a, b), abs=1e-6)  # float32


def test_scalar_product_and_scaling_are_numpys():
    a, b = RNG.normal(size=(2, 50, 3))
    dot = vectors.dot(components(a), components(b))
    assert np.asarray(dot) == pytest.approx((a * b).sum(1), abs=2e-6)  # float32
    assert stacked(vectors.scale(2.0, components(a))) == pytest.approx(2 * a, rel=1e-6)


def test_rotation_is_mujocos_and_its_columns_are_the_body_axes():
    a = RNG.normal(size=(20, 3))
    q = random_quaternions(20)
    rotation = vectors.rotation(components(q))
    world = stacked(vectors.to_world(rotation, components(a)))
    back = stacked(vectors.to_body(rotation, vectors.to_world(rotation, components(a))))
    for i in range(20):
        expected = np.zeros(9)
        mujoco.mju_quat2Mat(expected, q[i])
        matrix = expected.reshape(3, 3)
        assert world[i] == pytest.approx(matrix @ a[i], abs=2e-6)  # float32
        for k in range(3):
            axis = stacked(vectors.column(rotation, k))[i]
            assert axis == pytest.approx(matrix[:, k], abs=1e-6)
    assert back == pytest.approx(a, abs=3e-6)


def test_a_symmetric_system_is_solved_and_multiplies_back():
    for _ in range(20):
        root = RNG.normal(size=(3, 3))
        matrix = root @ root.T + 0.5 * np.eye(3)
        b = RNG.normal(size=3)
        six = tuple(
            jnp.array(matrix[i, j])
            for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        )
        x = vectors.solve(six, tuple(jnp.array(v) for v in b))
        assert stacked(x) == pytest.approx(np.linalg.solve(matrix, b), rel=1e-4)
        assert stacked(vectors.multiply(six, x)) == pytest.approx(b, abs=2e-5)


@pytest.mark.parametrize("rate", [0.0, 1e-20, 1e-3, 1.0, 60.0])
def test_turning_integrates_as_mujoco_does(rate: float):
    q = random_quaternions(20)
    angular = rate * RNG.normal(size=(20, 3))
    turned = stacked(vectors.rotate_by(components(q), components(angular), 0.01))
    for i in range(20):
        expected = q[i].copy()
        mujoco.mju_quatIntegrate(expected, angular[i], 0.01)
        assert turned[i] == pytest.approx(expected, abs=3e-7)  # float32
    assert np.linalg.norm(turned, axis=1) == pytest.approx(np.ones(20), abs=2e-7)


def test_a_body_at_rest_turns_as_soon_as_it_is_turned():
    def yawed(rate):
        zero = jnp.zeros(())
        start = jnp.ones(()), zero, zero, zero
        return vectors.rotate_by(start, (zero, zero, rate), 0.1)[3]

    assert jax.grad(yawed)(0.0) == pytest.approx(0.05)  # the half angle, dt / 2
