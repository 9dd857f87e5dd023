"""`python eval/render.py`: equals `carpark_mj render`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("render", "carpark_mj.programs:run", "render")
