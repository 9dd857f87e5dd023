"""`python eval/benchmark.py`: see `carpark_mj.programs.benchmark`."""

from carpark_mj.cli.process import enter

if __name__ == "__main__":
    enter("benchmark", "carpark_mj.programs.benchmark:run")
