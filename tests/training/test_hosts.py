"""Training on several hosts and devices; `test_ppo` trains on two hosts."""

import dataclasses

import jax
import numpy as np
import pytest
from helpers import splitting
from helpers.learning import SMALL, sliding_learner

from carpark_mj.config import EnvConfig, insert
from carpark_mj.layouts import StreetConfig
from carpark_mj.training import hosts
from carpark_mj.training.hosts import Hosts, read_hosts
from carpark_mj.training.ppo import learner as learner_module
from carpark_mj.training.ppo.collect import AXIS
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learner import num_devices
from carpark_mj.training.ppo.parts import PRESETS


def test_flags_of_hosts_are_taken_out_of_the_others():
    arguments = ["--seed", "3", "--coordinator=a:1", "--num-hosts", "2", "--host", "1"]
    assert read_hosts(arguments) == (Hosts("a:1", 2, 1), ["--seed", "3"])
    others = ["--help", "--num-lots", "4"]
    assert read_hosts(others) == (Hosts(), others)


IMPOSSIBLE = [
    (["--num-hosts", "2"], "need coordinator"),
    (["--coordinator", "auto", "--host", "0"], "HOST:PORT, not 'auto'"),
    (["--coordinator", "a:b"], "coordinator must be HOST:PORT"),
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

    monkeypatch.setattr(learner_module, "learn", no_learning)
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
