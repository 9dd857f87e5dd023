"""Runs of BenchMARL's algorithms from start to end."""

import logging
import os
import warnings
from pathlib import Path

from carpark_mj.training.run_folder import open_run
from carpark_papers.cederle.benchmarl.config import BenchMARLConfig

# Read when they are imported: our bar is the one shown, and JAX shares a GPU.
os.environ.setdefault("TQDM_DISABLE", "1")
os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")

from carpark_papers.cederle.benchmarl.train import Training


def train_run(config: BenchMARLConfig) -> tuple[Path, bool]:
    """Trains a run; returns its folder and whether it is finished.

    Raises:
        ValueError: impossible settings.
        CheckpointError: a checkpoint to resume from is damaged.
    """
    with open_run(config) as folder, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="No episode terminated")
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        logging.getLogger("torchrl").setLevel(logging.WARNING)
        print(f"run {folder}")
        print("compiling ...", flush=True)
        return folder, Training(config, folder).train()
