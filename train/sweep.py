"""`python train/sweep.py`: the same as `carpark_mj sweep`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("sweep", "carpark_mj.programs:run", "sweep")
