"""Lots as torch tensors, which share memory with what JAX computed."""

import numpy as np
import pytest
from helpers.sliding import MAX_STEPS, slide

torch = pytest.importorskip("torch", reason='pip install -e ".[sb3]"')

from carpark_mj.wrappers.batch import NumpyBatch  # noqa: E402
from carpark_mj.wrappers.torch_batch import TorchBatch  # noqa: E402


def batch():
    return TorchBatch(slide(respawn=False)[0], 4)


def test_tensors_hold_the_numbers_of_the_numpy_batch():
    lots, reference = batch(), NumpyBatch(slide(respawn=False)[0], 4)
    np.testing.assert_array_equal(lots.reset(3), reference.reset_numpy(3))
    for seed in range(MAX_STEPS + 2):
        action = np.random.default_rng(seed).uniform(-1, 1, (4, 3, 2))
        step = lots.step(torch.as_tensor(action))
        expected = reference.step_numpy(action)
        for name, tensor in step._asdict().items():
            np.testing.assert_array_equal(tensor, getattr(expected, name), name)
    assert step.terminated.dtype == torch.bool
    assert step.observation.dtype == torch.float32


def test_tensors_share_memory_and_stay_as_they_are():
    lots = batch()
    lots.reset(0)
    seen = []
    step_jax, shown = lots.batch.step, []
    lots.batch.step = lambda action: shown.append(step_jax(action)) or shown[-1]
    for _ in range(2 * MAX_STEPS):
        step = lots.step(torch.rand(4, 3, 2))
        seen.append((step, [tensor.clone() for tensor in step]))
        pointer = shown[-1].observation.unsafe_buffer_pointer()
        assert step.observation.data_ptr() == pointer
        assert step.reward.data_ptr() == shown[-1].reward.unsafe_buffer_pointer()
    shown.clear()
    for step, clones in seen:
        for tensor, clone in zip(step, clones, strict=True):
            assert torch.equal(tensor, clone)


def test_actions_may_be_strided_and_require_gradients():
    one, other = batch(), batch()
    one.reset(0)
    other.reset(0)
    plain = torch.rand(4, 3, 2)
    strided = plain.permute(2, 1, 0).contiguous().permute(2, 1, 0).requires_grad_()
    assert not strided.is_contiguous()
    step = one.step(strided)
    expected = other.step(plain)
    plain.zero_()
    assert not step.observation.requires_grad
    for mine, theirs in zip(step, expected, strict=True):
        assert torch.equal(mine, theirs)


def test_lots_that_are_due_begin_anew():
    lots = batch()
    lots.reset(0)
    due = [True, False, False, True]
    observation = lots.restart(torch.tensor(due))
    assert observation.abs().sum(dim=(1, 2)).bool().tolist() == due
