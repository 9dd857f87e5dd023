"""`python eval/suite.py`: see `carpark_mj.studies.hope.program`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("suite", "carpark_mj.studies.hope.program:run")
