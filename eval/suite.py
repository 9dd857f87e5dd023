"""`python eval/suite.py`: see `carpark_mj.programs.suite`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("suite", "carpark_mj.programs.suite:run")
