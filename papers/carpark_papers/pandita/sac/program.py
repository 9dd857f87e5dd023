"""Trains one car to park in slots with SAC and hindsight replay, phase by phase.

    carpark_mj study sac                              # vertical slots, runs/slots-0
    carpark_mj study sac --phases slots:60000 slots_diagonal:60000  # what is forgotten?
    carpark_mj study sac --phases slots,slots_diagonal,slots_parallel:400000
    carpark_mj study sac --phases slots:150episodes slots_diagonal:150episodes
    carpark_mj study sac --preset pandita             # the settings of Pandita 2022
    carpark_mj study sac --resume runs/slots-0        # continues where it stopped

It needs `pip install "./papers[sb3]"`. After every phase the policy is deployed
on all kinds of lots. Ctrl-C saves a checkpoint and stops; a second one stops at once.
"""

from collections.abc import Sequence

from carpark_mj.cli.process import enable_output_fusion
from carpark_mj.rendering.gl import choose_gl


def run(arguments: Sequence[str] | None = None) -> None:
    """Trains."""
    choose_gl()  # before MuJoCo is imported; without GL there is no video at the end
    enable_output_fusion()
    from carpark_mj.training.run_folder import read_settings
    from carpark_papers.pandita.sac.config import SAC_PRESETS, SAC_SUMMARIES

    config = read_settings(
        SAC_PRESETS["slots"], SAC_PRESETS, arguments, __doc__, SAC_SUMMARIES
    )
    from carpark_papers.pandita.sac.train import train_run

    folder, done = train_run(config)
    if done:
        print(f"done: {folder}")
    else:
        print(f"stopped; continue with: carpark_mj study sac --resume {folder}")
