"""`python train/ppo.py`: the same as `carpark_mj train`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("ppo", "carpark_mj.programs:run", "train")
