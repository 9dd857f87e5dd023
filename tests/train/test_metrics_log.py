"""The log of a run: what TensorBoard reads of it, and a disk that is full."""

import contextlib

import pytest
from helpers.disks import largest_file

from learners.metrics_log import MetricsLog, read_metrics


def test_tensorboard_reads_what_is_logged(tmp_path):
    accumulator = pytest.importorskip(
        "tensorboard.backend.event_processing.event_accumulator"
    )
    for begun in (0, 2):  # a run, then resumed after its second update
        with contextlib.closing(MetricsLog(tmp_path, begun)) as log:
            for update in range(begun + 1, begun + 4):
                log.write({"update": update, "env_steps": 10 * update, "a": update / 2})
    events = accumulator.EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    found = [(event.step, event.value) for event in events.Scalars("a")]
    assert found == [(10 * update, update / 2) for update in range(1, 6)]
    rows = [(row["env_steps"], row["a"]) for row in read_metrics(tmp_path)]
    assert rows == found


def fill(folder):
    with contextlib.closing(MetricsLog(folder, 0)) as log:
        for update in range(10_000):
            log.write({"update": update, "env_steps": update, "a": 0.5})


def test_a_full_disk_ends_the_log_with_the_name_of_a_file(tmp_path):
    with largest_file(20_000), pytest.raises(OSError, match=str(tmp_path)):
        fill(tmp_path)
