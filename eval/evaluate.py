"""`python eval/evaluate.py`: see `carpark_mj.programs.evaluate`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("evaluate", "carpark_mj.programs.evaluate:run")
