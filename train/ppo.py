"""`python train/ppo.py`: runs `carpark_mj train`."""

import sys
from pathlib import Path

if __name__ == "__main__":
    # This checkout, not an installed copy.
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from carpark_mj.cli.process import enter

    enter("ppo", "carpark_mj.programs:run", "train")
