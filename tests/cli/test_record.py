"""Recordings repeat: Minari reads them, and their actions give what they hold."""

import dataclasses
import json

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector.utils import batch_space

from carpark_mj.cli import record as command
from carpark_mj.cli.play import PlayConfig, make_env, save
from carpark_mj.cli.record import record
from carpark_mj.cli.settings.driving import RecordConfig
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.play.demonstration import STEPS, Demonstration, load_demonstration
from carpark_mj.play.driving import DrivenLot
from carpark_mj.policy.named import zero_policy
from carpark_mj.policy.runs import from_dict
from carpark_mj.wrappers.gymnasium_env import one_agent

EPISODES = 5
SEED = 7


def settings(out):
    return RecordConfig(
        "random",
        environment="first",
        seed=SEED,
        episodes=EPISODES,
        num_lots=4,  # the last ones are filled up
        set=("episode.max_steps=30",),
        out=str(out),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    pytest.importorskip("minari")
    return command.main(settings(tmp_path_factory.mktemp("recording") / "data"))


def test_minari_reads_episodes_that_repeat(folder, monkeypatch):
    import minari

    monkeypatch.setenv(command.ROOT, str(folder))
    data = minari.load_dataset("carpark_mj/first/random-v0")
    assert data.total_episodes == EPISODES
    env = data.recover_environment()
    # What Minari's own tests ask of a data set.
    about = json.loads((folder / "recording.json").read_text())
    config = from_dict(EnvConfig, about["environment"]["config"])
    spec = gymnasium.make(command.ID, config=config).spec
    assert env.spec == EnvSpec.from_json(spec.to_json())
    assert data.observation_space == env.observation_space
    assert data.action_space == env.action_space
    for number, episode in enumerate(data):
        assert all(map(env.observation_space.contains, episode.observations))
        assert all(map(env.action_space.contains, episode.actions))
        seen, _ = env.reset(seed=SEED + number)
        observations, poses = [seen], episode.infos["pose"]
        assert len(episode) < 31
        for step, action in enumerate(episode.actions):
            seen, reward, terminated, truncated, info = env.step(action)
            observations.append(seen)
            assert reward == pytest.approx(episode.rewards[step], abs=1e-4)
            assert terminated == episode.terminations[step]
            assert truncated == episode.truncations[step]
            assert info["crashed"] == episode.infos["crashed"][step + 1]
        assert terminated or truncated
        np.testing.assert_allclose(observations, episode.observations, atol=1e-4)
        assert poses.shape == (len(observations), 3)
        pose = env.unwrapped._batch.state.motion.pose_w[0, 0]
        np.testing.assert_allclose(poses[-1], pose, atol=1e-4)


def test_arrays_hold_the_same_in_rows(folder, monkeypatch):
    import minari

    data = minari.MinariDataset(folder / "carpark_mj" / "first" / "random-v0" / "data")
    about = json.loads((folder / "recording.json").read_text())
    with np.load(folder / "episodes.npz") as arrays:
        assert len(arrays["rewards"]) == about["steps"] == data.total_steps
        for number, episode in enumerate(data):
            own = arrays["episode"] == number
            np.testing.assert_array_equal(arrays["actions"][own], episode.actions)
            seen = episode.observations
            np.testing.assert_array_equal(arrays["observations"][own], seen[:-1])
            np.testing.assert_array_equal(arrays["next_observations"][own], seen[1:])
        assert about["parked"] == arrays["is_success"].sum() / EPISODES
    config = from_dict(EnvConfig, about["environment"]["config"])
    env = gymnasium.make(about["environment"]["id"], config=config)
    assert env.unwrapped._batch.env.config == one_agent(config)


def test_the_same_command_gives_the_same_hash(folder, tmp_path):
    again = command.main(settings(tmp_path / "again"))
    one, other = (
        json.loads((x / "recording.json").read_text()) for x in (folder, again)
    )
    assert one["sha256"] == other["sha256"]
    with pytest.raises(ValueError, match="choose another folder"):
        command.main(settings(again))


def test_noise_is_on_actions_that_are_executed(folder):
    about = json.loads((folder / "recording.json").read_text())
    config = one_agent(from_dict(EnvConfig, about["environment"]["config"]))
    env = ParkingEnv(config)
    made = [*record(env, zero_policy(env.action_spec), range(20), 20, noise=0.3)]
    actions = np.concatenate([episode.actions for episode in made])
    assert actions.std() == pytest.approx(0.3, rel=0.1)
    assert {len(episode.rewards) for episode in made} == {30}  # none reaches anything
    moved = [np.ptp(episode.infos["pose"][:, :2]) for episode in made]
    assert min(moved) > 0.0


def test_drives_of_people_become_a_data_set_of_their_episodes(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    env, others = make_env(PlayConfig(environment="first"))
    ahead = np.float32([[0.0, 1.0]])
    lot = DrivenLot(env, others, 0, lambda lot: ahead)
    drives = tmp_path / "drives"
    while dict(lot.tally())["crashed"] + dict(lot.tally())["timed_out"] < 3:
        lot.step()
    for _ in range(3 * lot.traces):  # an episode that does not end
        lot.step()
    save(lot, drives)
    out = command.main(RecordConfig(str(drives), out=str(tmp_path / "data")))
    monkeypatch.setenv(command.ROOT, str(out))
    data = minari.load_dataset("carpark_mj/park/drives-v0")
    drive, begin = lot.demonstration, 0
    assert data.total_episodes >= 3
    assert data.total_steps < len(drive)
    single = data.recover_environment()
    for episode in data:
        assert episode.observations in batch_space(
            single.observation_space, len(episode.observations)
        )
        rows = slice(begin, begin := begin + len(episode))
        np.testing.assert_array_equal(episode.actions, drive.actions[rows, 0])
        np.testing.assert_array_equal(episode.rewards, drive.rewards[rows, 0])
        seen = drive.observations[rows, 0]
        np.testing.assert_array_equal(episode.observations[:-1], seen)
        # The last observation is not that of the next episode.
        assert (episode.observations[-1] != drive.observations[begin, 0]).any()
        ended = episode.infos["crashed"] | episode.infos["is_success"]
        assert ended[-1] or episode.truncations[-1]
        assert not ended[:-1].any()
    first = load_demonstration(drives / "drive-0.npz")
    other = dataclasses.replace(first.config, layout="street")
    parts = {name: getattr(first, name) for name in STEPS}
    Demonstration(other, 0, **parts).save(drives / "drive-1.npz")
    with pytest.raises(ValueError, match="one agent in one environment"):
        command.main(RecordConfig(str(drives), out=str(tmp_path / "no")))
