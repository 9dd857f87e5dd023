"""`python -m carpark_mj.play`, another name of `carpark_mj play`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("play", "carpark_mj.programs:run", "play")
