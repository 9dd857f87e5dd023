"""`python train/q_learning.py`: see `carpark_mj.studies.tanner.q_learning.program`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("q_learning", "carpark_mj.studies.tanner.q_learning.program:run")
