"""`python train/sweep.py`: see `carpark_mj.programs.sweep`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("sweep", "carpark_mj.programs.sweep:run")
