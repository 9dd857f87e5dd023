"""SAC runs from start to end: the folder, the training and its files."""

import sys
from pathlib import Path

from carpark_mj.files import write_json
from carpark_mj.training.run_folder import open_run
from carpark_papers.pandita.sac.config import SACConfig
from carpark_papers.pandita.sac.pictures import plot_matrix, plot_phases
from carpark_papers.pandita.sac.train import Training, train
from carpark_papers.pandita.sac.transfer import Transfer, success_matrix, transfer


def finish(training: Training) -> None:
    """Learning curve, success matrix, transfer and a video."""
    config, folder = training.config, training.folder
    print(f"wrote {plot_phases(folder)}")
    rows, phases = training.deployments, config.schedule
    matrices = {
        policy: success_matrix(rows, config.kinds, policy)
        for policy in ("deterministic", "sampled")
    }
    names = ["untrained", *map(str, phases)]
    path = folder / "success_matrix.png"
    print(f"wrote {plot_matrix(path, matrices['deterministic'], names, config.kinds)}")
    found = {
        policy: vars(transfer(matrix, config.kinds, phases))
        for policy, matrix in matrices.items()
    }
    last = [row for row in rows if row["phase"] == len(phases)]
    write_json(folder / "evaluation.json", {"transfer": found, "kinds": last})
    for row in last:
        print(
            f"{row['kind']}, {row['policy']}: success {row['success']:.1%} "
            f"({row['success_low']:.1%} to {row['success_high']:.1%}), crashed "
            f"{row['crashed']:.1%}, timed out {row['timed_out']:.1%}"
        )
    if len(phases) > 1:
        print(_words(Transfer(**found["deterministic"])))
    if config.video_seconds:
        from carpark_mj.rendering.renderer import RenderingError
        from carpark_papers.pandita.sac.video import write_drives

        try:
            print(f"wrote {write_drives(training, folder / 'video.mp4')}")
        except RenderingError as error:
            print(f"no video: {error}", file=sys.stderr)


def _words(found: Transfer) -> str:
    return (
        f"backward transfer {found.backward:+.2f}, forward transfer "
        f"{found.forward:+.2f}, average success {found.average:.1%}"
    )


def train_run(config: SACConfig) -> tuple[Path, bool]:
    """Trains and finishes a run; returns its folder and whether it is finished.

    Raises:
        ValueError: impossible settings.
        CheckpointError: a checkpoint to resume from is damaged.
    """
    with open_run(config) as folder:
        training = train(config, folder)
        if training:
            finish(training)
    return folder, training is not None
