"""`python eval/evaluate.py`: equals `carpark_mj evaluate`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("evaluate", "carpark_mj.programs:run", "evaluate")
