"""The learning curve's moving average, and the picture of runs long and short."""

import csv

import numpy as np
import pytest

from carpark_mj.training.loop import plot_learning_curve, smooth


def test_smoothing_weights_by_episodes_and_keeps_constants():
    np.testing.assert_allclose(smooth(np.full(50, 0.3), np.arange(1.0, 51.0)), 0.3)
    # Two updates: one episode with rate 1, three with rate 0.
    np.testing.assert_allclose(smooth(np.array([1.0, 0.0]), np.array([1.0, 3.0]))[0], 1)
    np.testing.assert_allclose(
        smooth(np.array([1.0, 0.0, 0.0]), np.array([1.0, 3.0, 0.0]), window=3)[1], 0.25
    )


@pytest.mark.parametrize("episodes", [(), (0, 0), (0, 3, 2)])
def test_a_run_in_which_no_episode_ended_still_has_a_picture(tmp_path, episodes):
    names = ("parked", "crashed", "timed_out", "episode_return")
    columns = ["update", "env_steps", "episodes", *(f"episode/{n}" for n in names)]
    with (tmp_path / "metrics.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for k, count in enumerate(episodes):
            rate = "0.5" if count else "nan"
            writer.writerow([k + 1, 100 * (k + 1), count, rate, rate, rate, rate])
    assert plot_learning_curve(tmp_path).read_bytes()[:4] == b"\x89PNG"
