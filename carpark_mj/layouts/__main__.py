"""`python -m carpark_mj.layouts`: see `carpark_mj.cli.layouts`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("layouts", "carpark_mj.cli.layouts:main")
