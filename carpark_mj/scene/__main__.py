"""`python -m carpark_mj.scene`: see `carpark_mj.cli.scene`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("scene", "carpark_mj.cli.scene:run")
