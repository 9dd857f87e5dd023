"""Flags of several hosts, and what is refused; `test_ppo` trains on two."""

import dataclasses

import jax
import pytest

from carpark_mj.training import hosts
from carpark_mj.training.hosts import Hosts, read_hosts
from carpark_mj.training.ppo.learner import num_devices
from carpark_mj.training.ppo.parts import PRESETS


def test_flags_of_hosts_are_taken_out_of_the_others():
    arguments = ["--seed", "3", "--coordinator=a:1", "--num-hosts", "2", "--host", "1"]
    assert read_hosts(arguments) == (Hosts("a:1", 2, 1), ["--seed", "3"])
    assert read_hosts(["--help", "--num-lots", "4"]) == (
        Hosts(),
        ["--help", "--num-lots", "4"],
    )


IMPOSSIBLE = [
    (["--num-hosts", "2"], "need coordinator"),
    (["--coordinator", "auto", "--host", "0"], "HOST:PORT, not 'auto'"),
    (["--coordinator", "a"], "coordinator must be HOST:PORT"),
    (["--coordinator", "a:b"], "coordinator must be HOST:PORT"),
    (["--coordinator", "a:1"], "num_hosts must be at least 1"),
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
