"""`python train/slots_study.py`: see `carpark_mj.studies.pandita.experiments`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("slots_study", "carpark_mj.studies.pandita.experiments.program:run")
