"""Videos of the junction: what is recorded, and what stands below the cars."""

import dataclasses

import imageio_ffmpeg
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_papers.cederle import video
from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.junction.rules import KEEP_LANE, SLOW_DOWN
from carpark_papers.cederle.training.evaluations import record, write_video

CONFIG = DQNConfig(scenario="2av-hd", video_episodes=2, eval_jitter=0.0)


def act(observation):
    """The one from the east stands; the one from the west drives."""
    return jnp.tile(jnp.array([SLOW_DOWN, KEEP_LANE]), (len(observation), 1))


@pytest.fixture(scope="module")
def drives():
    return record(CONFIG, act)


def test_episodes_are_recorded_till_all_agents_are_done(drives):
    assert len(drives) == 2
    for drive in drives:
        assert len(drive.states) == len(drive.actions) == len(drive.ended)
        assert drive.states[-2].active.any()
        assert drive.states[0].motion.pose_w.shape == (3, 3)
        np.testing.assert_array_equal(drive.actions[5], [SLOW_DOWN, KEEP_LANE])


def test_below_every_car_stands_what_it_intends_or_how_it_ended(
    drives, tmp_path, monkeypatch
):
    seen = []

    def labels(frame, renderer, shown, camera):
        seen.append(shown)
        return frame

    monkeypatch.setattr(video, "draw_labels", labels)
    monkeypatch.setattr(video, "SIZE", (64, 64))
    path = video.write_drives(tmp_path / "video.mp4", CONFIG.junction, drives[:1])
    frames = 2 * len(drives[0].states)  # two traced instants of a step
    assert len(seen) == frames
    assert seen[19].seconds == pytest.approx(1.0)
    east, west, human = seen[10].state
    assert east.startswith("east: slow down, ")
    assert west.startswith("west: keep lane, ")
    assert human.startswith("human: keep lane, ")
    # One stands until its time is up; the other meets the human-driven car or arrives.
    ends = [text.split(": ")[1].split(",")[0] for text in seen[-1].state[:2]]
    crashed = bool(drives[0].ended[-1][1, 0])
    assert ends == ["timed out", "crashed" if crashed else "arrived"]
    assert seen[-1].tally == {"crashed": crashed}
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert count == frames + 20  # a second more
    assert seconds == pytest.approx(count / 20)


def test_cars_are_called_by_their_missions_whichever_agents_have_them(
    drives, tmp_path, monkeypatch
):
    seen = []
    monkeypatch.setattr(
        video, "draw_labels", lambda frame, _, shown, *__: seen.append(shown)
    )
    monkeypatch.setattr(video, "draw_status", lambda *_: np.zeros((64, 64, 3)))
    monkeypatch.setattr(video, "write_video", lambda _, frames, *__: [*frames])
    monkeypatch.setattr(video, "SIZE", (64, 64))
    first = drives[0].states[0]
    task = dataclasses.replace(first.task, order=np.array([1, 0, 2]))
    dealt = dataclasses.replace(
        drives[0],
        states=[dataclasses.replace(first, task=task)],
        actions=drives[0].actions[:1],
    )
    video.write_drives(tmp_path / "video.mp4", CONFIG.junction, [dealt])
    names = [text.split(":")[0] for text in seen[0].state]
    assert names == ["west", "east", "human"]


def test_there_is_no_video_where_none_is_wanted(tmp_path):
    write_video(tmp_path, dataclasses.replace(CONFIG, video_episodes=0), act)
    assert not [*tmp_path.iterdir()]
