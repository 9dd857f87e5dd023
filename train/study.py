"""`python train/study.py`: see `carpark_mj.studies.tanner.experiments.program`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("study", "carpark_mj.studies.tanner.experiments.program:run")
