"""A run of an untrained policy, and that policy beside the shipped ones."""

import shutil

import pytest
from helpers.tiny_policy import TINY, parked_learner

from carpark_mj import pretrained
from carpark_mj.policy import loading
from carpark_mj.training.ppo.train import save


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run folder with a checkpoint of an untrained policy."""
    folder = tmp_path_factory.mktemp("tiny_run")
    save(folder, TINY, parked_learner(TINY).init())
    return folder


@pytest.fixture
def shipped(run, tmp_path, monkeypatch):
    """The policy of the run as `tiny`, beside the others; the folder of them all."""
    folder = tmp_path / "package"
    shutil.copytree(pretrained.FOLDER, folder)
    loading.save_policy(run, folder / "tiny.npz")

    monkeypatch.setattr(pretrained, "FOLDER", folder)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return folder
