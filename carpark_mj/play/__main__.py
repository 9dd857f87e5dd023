"""`python -m carpark_mj.play`: see `carpark_mj.cli.play`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("play", "carpark_mj.cli.play:run")
