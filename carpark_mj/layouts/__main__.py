"""`python -m carpark_mj.layouts`, equal to `carpark_mj layouts`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("layouts", "carpark_mj.programs:run", "layouts")
