"""`python train/ppo.py`: see `carpark_mj.programs.train`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("ppo", "carpark_mj.programs.train:run")
