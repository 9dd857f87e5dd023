"""`python -m carpark_mj.scene`: the same as `carpark_mj scene`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("scene", "carpark_mj.programs:run", "scene")
