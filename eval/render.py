"""`python eval/render.py`: see `carpark_mj.programs.render`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("render", "carpark_mj.programs.render:run")
