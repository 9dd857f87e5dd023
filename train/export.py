"""`python train/export.py`: the same as `carpark_mj export`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("export", "carpark_mj.programs:run", "export")
