"""`python train/junction_study.py`: see `carpark_mj.studies.cederle.experiments`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("junction_study", "carpark_mj.studies.cederle.experiments.program:run")
