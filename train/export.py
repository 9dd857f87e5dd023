"""`python train/export.py`: see `carpark_mj.programs.export`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("export", "carpark_mj.programs.export:run")
