"""The learner: the update of Brax's PPO, the NaN guard, the GPU kernel, hosts."""

import dataclasses
import re
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State
from brax.training import acting
from brax.training import pmap as brax_pmap
from brax.training.agents.ppo import losses as ppo_losses
from brax.training.agents.ppo import train as brax_ppo
from brax.training.types import Transition
from helpers import splitting
from helpers.learning import SMALL, acted, rollout, sliding_learner
from helpers.sliding import POSES
from helpers.trees import assert_close, same
from jax.flatten_util import ravel_pytree
from jax.sharding import PartitionSpec

from carpark_mj.config import EnvConfig, insert
from carpark_mj.layouts import StreetConfig
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations.compose import OWN
from carpark_mj.observations.fields import Field
from carpark_mj.policy.networks import MIN_DEVIATION, NetworkConfig, make_networks
from carpark_mj.training import hosts
from carpark_mj.training.hosts import Hosts, read_hosts
from carpark_mj.training.ppo import learner as learners
from carpark_mj.training.ppo.collect import AXIS, compute_advantages
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learn import learn, network_params
from carpark_mj.training.ppo.learner import Learner, num_devices
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.ppo.variants import Minibatch, Weights, ppo_loss

TINY = dataclasses.replace(
    PRESETS["cpu"],
    num_lots=2,
    unroll_length=8,
    num_minibatches=1,
    num_epochs=3,
    num_steps=320,
    entropy_cost=0.0,  # Brax's entropy is sampled: with other keys it differs
    entropy_cost_end=0.0,
    learning_rate_end=PRESETS["cpu"].learning_rate,
    networks=NetworkConfig((16, 16), (16,), encoder="flat"),
    env=EnvConfig(physics="bicycle", observation=POSES, num_agents=2),
)
AGENTS = TINY.num_lots * TINY.env.num_agents
SHAPE = TINY.unroll_length, AGENTS


@pytest.fixture(scope="module")
def learner():
    return Learner(TINY)


@pytest.fixture(scope="module")
def update(learner):
    return learner.compile()


@pytest.fixture(scope="module")
def state(learner):
    return learner.init()


def canned_data(learner, state, seed):
    """A made-up unroll (time, agents, ...) with terminations.

    Nothing is truncated: Brax counts such steps where we do not.
    """
    rng, size = np.random.default_rng(seed), learner.env.observation_size

    def normal(*size):
        return jnp.asarray(rng.normal(size=size), jnp.float32)

    # Close to what the first normalizer expects, so that ratios stay finite after it.
    observation = 0.2 + 1.1 * normal(*SHAPE, size)
    parts = learner.networks, state.normalizer, state.policy
    raw, log_prob = acted(*parts, observation, normal(*SHAPE))
    return rollout(
        SHAPE,
        size,
        observation=observation,
        raw_action=raw,
        log_prob=log_prob,
        reward=normal(*SHAPE),
        terminated=jnp.asarray(rng.random(SHAPE) < 0.2, jnp.float32),
        final_observation=normal(AGENTS, size),
    )


def as_brax(steps):
    """The same as Brax takes it."""
    last = steps.final_observation[None]
    ends = {"truncation": steps.truncated, "episode_done": steps.terminated}
    policy = {"log_prob": steps.log_prob, "raw_action": steps.raw_action}
    policy |= {"distribution_params": jnp.zeros((*SHAPE, 4))}  # for the divergence
    return Transition(
        observation=steps.observation,
        action=jnp.tanh(steps.raw_action),
        reward=steps.reward,
        discount=1.0 - steps.terminated,
        next_observation=jnp.concatenate([steps.observation[1:], last]),
        extras={
            "policy_extras": policy,
            "state_extras": {**ends, "episode_metrics": {}},
        },
    )


def on_one_device(function):
    """The function compiled for one device, over which learning averages."""
    axes, whole = (jax.sharding.AxisType.Auto,), PartitionSpec()
    alone = jax.make_mesh((1,), (AXIS,), axis_types=axes, devices=jax.devices()[:1])
    spread = {"mesh": alone, "in_specs": whole, "out_specs": whole, "check_vma": False}
    return jax.jit(jax.shard_map(function, **spread))


def brax_update(learner, state, data, monkeypatch):
    """Parameters after one update of `brax.training.agents.ppo.train` on the data."""

    def replicate(tree, devices):
        return jax.tree.map(lambda x: jnp.stack([jnp.asarray(x)] * len(devices)), tree)

    monkeypatch.setattr(jax, "device_put_replicated", replicate, raising=False)
    # Its check of replicas means nothing on one device, and fails under this JAX.
    monkeypatch.setattr(brax_pmap, "assert_is_replicated", lambda tree: None)
    monkeypatch.setattr(acting, "generate_unroll", lambda env, s, *_, **__: (s, data))

    def factory(observation_size, action_size, preprocess_observations_fn):
        fields = [Field("all", observation_size[-1], -1.0, 1.0, "")]
        networks = make_networks(TINY.networks, fields, ActionSpec(action_size))

        def take(network):  # Brax's statistics are of the vector as a whole
            return dataclasses.replace(
                network, apply=lambda n, *args: network.apply({OWN: n}, *args)
            )

        return networks.replace(
            policy_network=take(networks.policy_network),
            value_network=take(networks.value_network),
        )

    size, zero = learner.env.observation_size, jnp.zeros(AGENTS)
    info = {"truncation": zero, "episode_done": zero, "episode_metrics": {}}
    start = State(None, jnp.zeros((AGENTS, size)), zero, zero, {}, info)
    # What Brax's trainer asks of an environment before it acts.
    asked = {"action_size": 2, "observation_size": size, "reset": lambda keys: start}
    given = {"num_timesteps": 1, "wrap_env": False, "run_evals": False}
    given |= {"num_envs": AGENTS, "batch_size": AGENTS, "max_devices_per_host": 1}
    given |= {"episode_length": 100, "num_minibatches": 1, "network_factory": factory}
    given |= {"normalize_observations": True, "entropy_cost": 0.0}
    given |= {"restore_params": (state.normalizer[OWN], state.policy, state.value)}
    _, params, _ = brax_ppo.train(
        SimpleNamespace(**asked),
        learning_rate=TINY.learning_rate,
        discounting=TINY.discount,
        unroll_length=TINY.unroll_length,
        num_updates_per_batch=TINY.num_epochs,
        clipping_epsilon=TINY.clip,
        gae_lambda=TINY.gae_lambda,
        max_grad_norm=TINY.max_grad_norm,
        **given,
    )
    return params


@pytest.fixture(scope="module")
def learned(learner):
    """What `learn` makes of a state and a rollout, compiled."""

    @on_one_device
    def update(state, rollout):
        key = jax.random.key(5)
        networks, inputs = learner.networks, learner.inputs
        return learn(TINY, networks, inputs, learner.optimizer, state, rollout, key)[0]

    return update


@pytest.mark.filterwarnings("ignore")  # Brax's trainer uses deprecated JAX names
def test_an_update_equals_brax_s_own_on_the_same_data(
    learner, learned, state, monkeypatch
):
    data = canned_data(learner, state, seed=0)
    ours = learned(jax.device_get(state), data)
    theirs = brax_update(learner, state, as_brax(data), monkeypatch)
    # Sums of numbers of about 1, in another order.
    assert_close(ours[0][OWN], theirs[0], rtol=1e-6, atol=1e-6)
    # Three Adam steps of 1.5e-3; measured agreement 2e-7.
    assert_close(ours[1:3], theirs[1:], atol=2e-6, equal_nan=False)
    moved = jax.tree.map(lambda a, b: np.abs(a - b).max(), ours[1], state.policy)
    assert max(jax.tree.leaves(moved)) > 1e-3


def test_the_loss_of_a_minibatch_equals_brax_s(learner, state):
    data = canned_data(learner, state, seed=1)
    params = network_params(state.policy, state.value)
    weights = Weights(entropy_cost=jnp.float32(0.3), clip=jnp.float32(0.05))
    given = learner.networks, state.normalizer

    def ours(params, key):
        def value(observation):
            apply = learner.networks.value_network.apply
            return apply(state.normalizer, params.value, observation)

        values = value(data.observation), value(data.final_observation)
        found = compute_advantages(data, *values, TINY.discount, TINY.gae_lambda)
        steps = data.observation, data.raw_action, data.log_prob, *found
        batch = Minibatch(*steps, weight=jnp.ones(SHAPE))
        return ppo_loss(params, *given, batch, weights, key)

    def brax(params, key):
        return ppo_losses.compute_ppo_loss(
            params,
            state.normalizer,
            jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), as_brax(data)),
            key,
            learner.networks,
            entropy_cost=0.3,
            discounting=TINY.discount,
            gae_lambda=TINY.gae_lambda,
            clipping_epsilon=0.05,
        )

    key = jax.random.key(6)
    mine = on_one_device(jax.grad(ours, has_aux=True))(params, key)
    theirs = jax.jit(jax.grad(brax, has_aux=True))(params, key)
    assert set(mine[1]) == set(theirs[1])
    for name in set(mine[1]) - {"kl_mean"}:
        np.testing.assert_allclose(mine[1][name], theirs[1][name], rtol=1e-5, atol=1e-6)
    assert_close(mine[0], theirs[0], atol=1e-6)
    assert min(np.abs(x).max() for x in jax.tree.leaves(mine[0])) > 1e-4


def test_what_was_done_in_a_truncated_step_changes_nothing(learner, learned, state):
    data = canned_data(learner, state, seed=3)
    cut = jnp.asarray(np.random.default_rng(4).random(SHAPE) < 0.2)
    ends = {"truncated": cut.astype(jnp.float32), "terminated": jnp.zeros(SHAPE)}
    data = dataclasses.replace(data, **ends)
    other = dataclasses.replace(
        data,
        raw_action=jnp.where(cut[..., None], 0.5, data.raw_action),
        log_prob=jnp.where(cut, -3.0, data.log_prob),
        reward=jnp.where(cut, 7.0, data.reward),
    )
    whole = dataclasses.replace(other, truncated=jnp.zeros(SHAPE))
    start = jax.device_get(state)
    ours, same, more = (learned(start, x) for x in (data, other, whole))
    assert_close(ours, same, atol=1e-7)
    moved = jax.tree.map(lambda a, b: np.abs(a - b).max(), ours[1], more[1])
    assert max(jax.tree.leaves(moved)) > 1e-3  # which it does if they are not


def test_rates_follow_the_time_used_without_recompiling(learner, state):
    config = dataclasses.replace(TINY, minutes=1.0, learning_rate_end=0.0)
    data = canned_data(learner, state, seed=2)
    parts = learner.networks, learner.inputs, learner.optimizer

    @on_one_device
    def moved(state, data):
        new, _ = learn(config, *parts, state, data, jax.random.key(5))
        pair = (state.policy, state.value), new[1:3]
        before, after = (ravel_pytree(x)[0] for x in pair)
        return jnp.abs(after - before).max()

    starts = [learner.set_seconds(state, s) for s in (0.0, 30.0, 59.0, 60.0, 99.0)]
    steps = [float(moved(jax.device_get(start), data)) for start in starts]
    assert steps[0] > steps[1] > steps[2] > 0.0
    assert steps[3] == steps[4] == 0.0
    assert moved._cache_size() == 1


def test_no_empty_array_is_an_input_of_the_compiled_update(update, state):
    """On several devices XLA of JAX 0.11.2 would crash."""
    assert state.env.pipeline_state.layout.disc_mask.size == 0
    program = update.lower(state).as_text()
    signature = program.split("@main(")[1].split(" -> ")[0]
    inputs = re.findall(r"%arg\d+: tensor<(\S*?)>", signature)
    walls = "x".join(map(str, state.env.pipeline_state.layout.wall_mask.shape))
    assert f"{walls}xi1" in inputs
    assert not [x for x in inputs if "0" in x.split("x")]


def test_a_non_finite_update_is_dropped_whole(learner, update):
    def parts(state):
        each = state.normalizer, state.policy, state.value, state.optimizer
        return jax.tree.map(np.array, each)  # the state itself is donated

    good, _ = update(learner.place(jax.device_get(learner.init())))
    before = jax.device_get(good)
    kept = parts(before)
    assert int(good.skipped) == 0
    # All bays are equal here: what never varied is not blown up either.
    assert before.normalizer[OWN].std.min() == np.float32(MIN_DEVIATION)
    nothing = np.full_like(before.env.obs, np.nan)
    poisoned = before.replace(env=before.env.replace(obs=nothing))
    after, metrics = update(learner.place(poisoned))
    after = jax.device_get(after)
    assert int(after.skipped) == int(metrics["skipped"]) == 1
    assert same(kept, parts(after))
    # The cars' actions were NaN: they are contained, and the next update is fine.
    assert np.isfinite(after.env.obs).all()
    final, metrics = update(learner.place(after))
    assert int(final.skipped) == 1
    assert np.isfinite(metrics["loss/total_loss"])
    assert update._cache_size() == 1  # no weak type recompiled it
    # What a run leaves is the mean of the policies: of the first alone, then with the
    # third update's at a weight of 1/3; the dropped one changed nothing.
    final = jax.device_get(final)
    assert_close(after.average, before.policy, atol=1e-7)
    mean = jax.tree.map(lambda a, b: a + (b - a) / 3, before.policy, final.policy)
    assert_close(final.average, mean, atol=1e-7)
    apart = jax.tree.map(lambda a, b: np.abs(a - b).max(), final.average, final.policy)
    assert min(jax.tree.leaves(apart)) > 1e-5


@pytest.mark.parametrize("half", [False, True])
def test_on_a_gpu_sets_are_encoded_in_the_kernel(monkeypatch, half):
    monkeypatch.setattr(learners, "has_triton", lambda: True)
    networks = NetworkConfig((16,), (16,), own_size=8, entity_size=16)
    config = dataclasses.replace(SMALL, networks=networks, half_precision=half)
    learner = Learner(config)
    traced = learner.compile().trace(learner.shapes())
    program = str(traced.jaxpr)
    assert "name=entities_gradient" in program
    assert ("bf16" in program) == half


# Several hosts and devices; `test_ppo` trains on two hosts


def test_flags_of_hosts_are_taken_out_of_the_others():
    arguments = ["--seed", "3", "--coordinator=a:1", "--num-hosts", "2", "--host", "1"]
    assert read_hosts(arguments) == (Hosts("a:1", 2, 1), ["--seed", "3"])
    others = ["--help", "--num-lots", "4"]
    assert read_hosts(others) == (Hosts(), others)


IMPOSSIBLE = [
    (["--num-hosts", "2"], "need coordinator"),
    (["--coordinator", "auto", "--host", "0"], "HOST:PORT, not 'auto'"),
    (["--coordinator", "a:1", "--num-hosts", "2", "--host", "2"], "host must lie in"),
    (["--num-hosts", "two"], "--num-hosts"),
]


@pytest.mark.parametrize(("arguments", "message"), IMPOSSIBLE)
def test_impossible_hosts_are_refused_in_a_sentence(arguments, message):
    with pytest.raises(ValueError, match=message) as caught:
        read_hosts(arguments)
    assert "\n" not in str(caught.value)


def test_several_hosts_use_all_devices_or_none(monkeypatch):
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    monkeypatch.setattr(jax, "device_count", lambda: 6)
    config = dataclasses.replace(PRESETS["cpu"], num_lots=12, num_minibatches=4)
    assert num_devices(config) == 6
    with pytest.raises(ValueError, match="over the 6 devices of 2 hosts"):
        num_devices(dataclasses.replace(config, num_lots=8))
    # On one host lots and minibatches divide over the devices used.
    monkeypatch.setattr(jax, "process_count", lambda: 1)
    config = PPOConfig(num_lots=8, num_minibatches=4, env=EnvConfig(num_agents=2))
    # 8 lots x 2 agents: 4 devices hold 4 agents each, one per minibatch; 5 and 6 do
    # not divide the lots.
    assert num_devices(config) == 4
    assert num_devices(dataclasses.replace(config, num_minibatches=16)) == 1


def test_what_fails_on_host_0_ends_the_others(monkeypatch):
    monkeypatch.setattr(hosts, "largest", lambda *values: (True,))
    monkeypatch.setattr(jax, "process_index", lambda: 1)
    with pytest.raises(ValueError, match="host 0 failed"):
        hosts.on_first(lambda: pytest.fail("called on another host"))
    monkeypatch.setattr(jax, "process_index", lambda: 0)
    with pytest.raises(ZeroDivisionError):
        hosts.on_first(lambda: 1 / 0)


def test_hosts_with_other_settings_are_refused(monkeypatch):
    hosts.require_same("mine")
    theirs = []

    def with_theirs(*values):
        theirs.append(values)
        return tuple(map(max, zip(*theirs, strict=True)))

    monkeypatch.setattr(hosts, "largest", with_theirs)
    hosts.require_same("mine")
    hosts.require_same("mine")
    with pytest.raises(ValueError, match="the same settings"):
        hosts.require_same("yours")


@pytest.mark.slow
def test_devices_learn_together_what_one_learns():
    splitting.assert_alike("brax")


@pytest.mark.slow
def test_devices_act_learn_and_draw_lots_differently(monkeypatch):
    # All lots are drawn anew after the update.
    changes = {"lot_life": 1, "env.layout": StreetConfig(bays_per_side=(3, 4))}
    learner = sliding_learner(insert(SMALL, changes))

    def no_learning(config, networks, inputs, optimizer, state, rollout, key):
        learned = (state.normalizer, state.policy, state.value, state.optimizer)
        return learned, {"act": rollout.raw_action, "learn": jax.random.uniform(key)}

    monkeypatch.setattr(learners, "learn", no_learning)
    update = jax.vmap(learner.update, in_axes=None, axis_size=2, axis_name=AXIS)
    after, metrics = jax.jit(update)(learner.init())
    layout = after.env.pipeline_state.layout
    drawn = {
        "acts": metrics["loss/act"],
        "learns": metrics["loss/learn"],
        "lots": layout.bay_pose,
    }
    for name, (one, other) in drawn.items():
        assert (one != other).any(), name
    # What all share stays the same.
    shared = dataclasses.replace(after, env=None, key=jax.random.key_data(after.key))
    for one, other in jax.tree.leaves(shared):
        np.testing.assert_array_equal(one, other)
