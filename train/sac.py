"""`python train/sac.py`: see `carpark_mj.studies.pandita.sac.program`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("sac", "carpark_mj.studies.pandita.sac.program:run")
