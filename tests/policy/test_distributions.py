"""Distributions of actions: closed forms, SciPy, integrals, samples, Brax's own."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.acme import running_statistics
from brax.training.agents.ppo import networks as ppo_networks
from brax.training.distribution import NormalTanhDistribution
from scipy import special, stats

from carpark_mj.mdp.actions import ActionSpec, sanitize_indices
from carpark_mj.observations.compose import OWN
from carpark_mj.observations.fields import Field
from carpark_mj.policy.distributions import action_distribution
from carpark_mj.policy.named import random_policy, zero_policy
from carpark_mj.policy.networks import (
    NetworkConfig,
    init_normalizer,
    make_networks,
    network_inputs,
)

GRID = ActionSpec(0, (5, 7, 3))
MIXED = ActionSpec(2, (3,))
SPECS = [GRID, MIXED, ActionSpec(1, (4, 4))]
DRAWS = 100_000


def parameters(spec, seed=0, n=None):
    """Of a random distribution, or of n."""
    size = action_distribution(spec).param_size
    shape = (size,) if n is None else (n, size)
    return jax.random.normal(jax.random.key(seed), shape)


def split(spec, params):
    """Parameters of the numbers, and probabilities of each branch."""
    ends = 2 * spec.continuous + np.cumsum((0, *spec.choices))
    logits = [np.asarray(params)[..., a:b] for a, b in itertools.pairwise(ends)]
    numbers = params[..., : 2 * spec.continuous]
    return numbers, [special.softmax(part.astype(float), axis=-1) for part in logits]


@pytest.fixture(scope="module")
def draws():
    """Of every kind: parameters, raw actions (DRAWS, size)."""

    def draw(spec):
        distribution, params = action_distribution(spec), parameters(spec)
        many = jnp.broadcast_to(params, (DRAWS, *params.shape))
        return params, distribution.sample_no_postprocessing(many, jax.random.key(1))

    return {spec: jax.jit(lambda spec=spec: draw(spec))() for spec in SPECS}


def assert_mean(samples, expected):
    """The mean of samples is as expected, to 4 standard errors."""
    samples = np.asarray(samples, float)
    error = samples.std(axis=0) / np.sqrt(len(samples))
    np.testing.assert_array_less(np.abs(samples.mean(axis=0) - expected), 4 * error)


@pytest.mark.parametrize("spec", [ActionSpec(2), MIXED])
@pytest.mark.parametrize(("least", "most"), [(0.001, 0.0), (0.1, 0.0), (0.1, 0.3)])
def test_deviations_of_numbers_stay_in_their_bounds(spec, least, most):
    distribution, n = action_distribution(spec, least, most), spec.continuous
    params = jnp.full((3, distribution.param_size), -100.0)
    params = params.at[1:, n : 2 * n].set(jnp.array([[0.0], [5.0]]))
    scale = distribution.create_dist(params).scale[:, :n]
    # Brax's softplus of the parameter, above the least.
    expected = least + np.log1p(np.exp([[-100.0], [0.0], [5.0]]))
    expected = np.minimum(expected, most or np.inf)
    np.testing.assert_allclose(scale, np.broadcast_to(expected, (3, n)), rtol=1e-5)


def test_numbers_alone_are_exactly_brax_s_networks():
    config = NetworkConfig((8, 8), (8,), encoder="flat")
    fields = [Field("x", 5, -1.0, 1.0, "")]
    ours = make_networks(config, fields, ActionSpec(2))
    theirs = ppo_networks.make_ppo_networks(
        5,
        2,
        preprocess_observations_fn=running_statistics.normalize,
        policy_hidden_layer_sizes=(8, 8),
        value_hidden_layer_sizes=(8,),
    )
    assert type(ours.parametric_action_distribution) is NormalTanhDistribution
    observation = jax.random.normal(jax.random.key(2), (3, 5))
    normalizer = init_normalizer(network_inputs(config, fields))

    for part in ("policy_network", "value_network"):

        def start(networks, normalizer, part=part):
            network = getattr(networks, part)
            params = network.init(jax.random.key(0))
            return params, network.apply(normalizer, params, observation)

        pairs = (ours, normalizer), (theirs, normalizer[OWN])
        found = [jax.jit(lambda pair=pair: start(*pair))() for pair in pairs]
        jax.tree.map(np.testing.assert_array_equal, *found)


@pytest.mark.parametrize("spec", SPECS)
def test_log_probability_and_entropy_of_the_choices_are_scipy_s(spec):
    distribution = action_distribution(spec)
    params = parameters(spec, 0, 6)
    n = spec.continuous
    key, raw_key = jax.random.split(jax.random.key(3))
    raw = jax.jit(distribution.sample_no_postprocessing)(params, raw_key)
    index = np.asarray(raw)[:, n:].astype(int)
    numbers, branches = split(spec, params)
    rows = np.arange(6)
    log_prob = sum(np.log(p[rows, index[:, i]]) for i, p in enumerate(branches))
    entropy = sum(stats.entropy(p, axis=-1) for p in branches)
    if n:  # the numbers' part is Brax's own
        brax = NormalTanhDistribution(n)
        log_prob += brax.log_prob(numbers, raw[:, :n])
        entropy += brax.entropy(numbers, jax.random.split(key)[0])

    @jax.jit
    def find(params):
        return distribution.log_prob(params, raw), distribution.entropy(params, key)

    for found, expected in zip(find(params), (log_prob, entropy), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("spec", SPECS)
def test_samples_are_as_frequent_as_their_probabilities_say(spec, draws):
    params, raw = draws[spec]
    numbers, branches = split(spec, params)
    n = spec.continuous
    for i, p in enumerate(branches):
        index = np.asarray(raw)[:, n + i]
        assert_mean(index[:, None] == np.arange(len(p)), p)
    if n:
        normal = NormalTanhDistribution(n).create_dist(numbers)
        assert_mean(raw[:, :n], normal.loc)
        assert_mean((raw[:, :n] - normal.loc) ** 2, normal.scale**2)
    # Independent of each other: no two correlate.
    correlation = np.corrcoef(np.asarray(raw, float), rowvar=False)
    off = correlation - np.eye(len(correlation))
    assert np.abs(off).max() < 4.5 / np.sqrt(DRAWS)


@pytest.mark.parametrize("spec", SPECS)
def test_the_mode_is_the_likeliest_and_actions_are_in_range(spec, draws):
    params, raw = draws[spec]
    distribution = action_distribution(spec)
    numbers, branches = split(spec, params)
    expected = [*np.tanh(numbers[: spec.continuous]), *map(np.argmax, branches)]
    mode = distribution.mode(params)
    np.testing.assert_allclose(mode, expected, rtol=1e-6)
    action = distribution.postprocess(raw)
    assert action.dtype == mode.dtype == spec.dtype
    n = spec.continuous
    assert (np.abs(action[:, :n]) <= 1.0).all()
    same, invalid = sanitize_indices(action[:, n:], spec.choices)
    np.testing.assert_array_equal(same, action[:, n:])
    assert not invalid.any()
    back = np.asarray(distribution.inverse_postprocess(action))
    unsaturated = np.abs(np.asarray(raw)[:, :n]).max(axis=1, initial=0.0) < 2.0
    assert unsaturated.mean() > 0.1
    np.testing.assert_allclose(back[unsaturated], raw[unsaturated], atol=1e-4)


def test_bins_are_values_at_equal_distances_that_may_have_two_modes():
    distribution = action_distribution(MIXED, bins=5)
    raw = jnp.array([[0, 2, 1], [4, 3, 2]])
    action = distribution.postprocess(raw)
    np.testing.assert_allclose(action, [[-1.0, 0.0, 1.0], [1.0, 0.5, 2.0]], atol=1e-6)
    np.testing.assert_array_equal(distribution.inverse_postprocess(action), raw)
    p = np.array([0.4, 0.05, 0.05, 0.05, 0.45])  # either end, but not between
    params = jnp.log(jnp.concatenate([p, p[::-1], jnp.array([0.2, 0.3, 0.5])]))
    np.testing.assert_allclose(distribution.mode(params), [1.0, -1.0, 2.0], rtol=1e-6)
    log_prob = np.log([0.4 * 0.05 * 0.3, 0.45 * 0.05 * 0.5])
    found = distribution.log_prob(jnp.stack([params, params]), raw)
    np.testing.assert_allclose(found, log_prob, rtol=1e-5)


def test_reported_moments_are_those_of_the_indices():
    dist = action_distribution(GRID).create_dist(parameters(GRID))
    for i, p in enumerate(split(GRID, parameters(GRID))[1]):
        index = stats.rv_discrete(values=(np.arange(len(p)), p))
        np.testing.assert_allclose(dist.loc[i], index.mean(), rtol=1e-5)
        np.testing.assert_allclose(dist.scale[i], index.std(), rtol=1e-4)


@pytest.mark.parametrize("spec", [ActionSpec(2), *SPECS])
def test_baselines_stand_still_or_draw_evenly(spec):
    observation = jnp.zeros((20_000, 3, 4))
    n = spec.continuous
    action, _ = zero_policy(spec)(observation, jax.random.key(0))
    assert action.dtype == spec.dtype
    assert action.shape == (20_000, 3, spec.size)
    middle = [0.0] * n + [(count - 1) // 2 for count in spec.choices]
    np.testing.assert_array_equal(action[7, 1], middle)
    action, _ = random_policy(spec)(observation, jax.random.key(0))
    assert action.dtype == spec.dtype
    drawn = np.asarray(action).reshape(-1, spec.size)
    assert_mean(drawn[:, :n], 0.0)
    assert_mean(drawn[:, :n] ** 2, 1 / 3)
    assert np.abs(drawn[:, :n]).max(initial=0.0) <= 1.0
    for i, count in enumerate(spec.choices):
        assert_mean(drawn[:, n + i, None] == np.arange(count), 1 / count)
