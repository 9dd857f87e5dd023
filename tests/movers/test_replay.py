"""Recorded drives that move other cars, and files that are none."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.movers import Replay
from carpark_mj.vehicle.presets import COMPACT

HEAD = "id,time,x,y,yaw,length,width\n"
GOOD = HEAD + "a,1,0,0,3.0,4,2\na,3,4,2,-3.0,4,2\nb,2,9,9,0,5,2\nb,7,9,19,1,5,2\n"


def write(folder, text, name="drives.csv"):
    path = folder / name
    path.write_text(text)
    return str(path)


def test_it_interpolates_and_cars_are_there_while_they_drove(tmp_path):
    mover = Replay(write(tmp_path, GOOD), offset=(0.0, 0.0))
    state = mover.init(jax.random.key(0), None)
    assert float(state) == 0.0  # the time of the first sample
    [boxes] = mover.obstacles(mover.step(None, state, None, 0.5))
    np.testing.assert_array_equal(boxes.mask, [True, False])
    np.testing.assert_allclose(boxes.pose_w[0, :2], [1.0, 0.5], atol=1e-6)
    turned = 3.0 + 0.25 * (2 * np.pi - 6.0)  # the short way
    assert float(boxes.pose_w[0, 2]) == pytest.approx(turned, abs=1e-5)
    np.testing.assert_allclose(boxes.velocity_w[0], [2.0, 1.0], atol=1e-4)
    [boxes] = mover.obstacles(jnp.float32(3.0))
    np.testing.assert_array_equal(boxes.mask, [False, True])
    np.testing.assert_allclose(boxes.pose_w[1, :2], [9.0, 13.0], atol=1e-5)
    np.testing.assert_allclose(boxes.size, [[4, 2], [5, 2]])
    again = mover.step(None, jnp.float32(7.9), None, 0.2)  # 6 s and a pause of 2 s
    assert float(again) == pytest.approx(0.1, abs=1e-5)


def test_offsets_are_drawn_from_the_whole_recording(tmp_path):
    mover = Replay(write(tmp_path, GOOD))
    keys = jax.random.split(jax.random.key(0), 300)
    start = np.asarray(jax.vmap(lambda key: mover.init(key, None))(keys))
    assert start.min() < 0.5
    assert 7.5 < start.max() < 8.0


def archive(folder, poses, ended=(), **header):
    config = {"sim": {"ctrl_dt": 0.2}, "vehicle": "compact"}
    steps, agents = poses.shape[:2]
    terminated = np.zeros((steps, agents), bool)
    for row in ended:
        terminated[row] = True
    np.savez(
        folder / "drive.npz",
        header=json.dumps({"config": config} | header),
        poses=poses.astype(np.float32),
        terminated=terminated,
        truncated=np.zeros_like(terminated),
    )
    return str(folder / "drive.npz")


def test_what_play_saves_moves_a_car_for_each_episode(tmp_path):
    poses = np.zeros((6, 1, 3))
    poses[:3, 0, 0], poses[3:, 0, 0] = [0, 1, 2], [50, 51, 52]
    mover = Replay(archive(tmp_path, poses, ended=[(2, 0)]), offset=(0, 0))
    [boxes] = mover.obstacles(jnp.float32(0.3))
    np.testing.assert_array_equal(boxes.mask, [True, False])
    assert float(boxes.pose_w[0, 0]) == pytest.approx(1.5)
    assert float(boxes.size[0, 0]) == pytest.approx(COMPACT.length)


def test_no_such_files(tmp_path):
    write(tmp_path, GOOD, "drives.txt")
    for name, sentence in {
        "drives.txt": "ends in .csv or .npz, not 'drives.txt'",
        "none.csv": "cannot read.*none.csv: No such file",
    }.items():
        with pytest.raises(ValueError, match=sentence):
            Replay(str(tmp_path / name))
    write(tmp_path, GOOD, "drives.npz")
    with pytest.raises(ValueError, match="another kind of file"):
        Replay(str(tmp_path / "drives.npz"))
    with pytest.raises(ValueError, match="'config' of dict"):
        Replay(archive(tmp_path, np.zeros((3, 1, 3)), config=1))
    with pytest.raises(ValueError, match="not finite"):
        Replay(archive(tmp_path, np.full((3, 1, 3), np.nan)))
    with pytest.raises(ValueError, match="needs a path"):
        Replay().init(jax.random.key(0), None)
