"""`python eval/analysis.py`: see `carpark_mj.programs.analysis`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("analysis", "carpark_mj.programs.analysis:run")
