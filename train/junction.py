"""`python train/junction.py`: see `carpark_mj.studies.cederle.training.program`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("junction", "carpark_mj.studies.cederle.training.program:run")
