"""The command `carpark_mj`; `python -m carpark_mj` is the same."""

import sys
from typing import NoReturn

from carpark_mj import __version__
from carpark_mj.cli.process import enter
from carpark_mj.extensions import table
from carpark_mj.programs import COMMANDS


def main() -> NoReturn:
    """Runs the program that the first argument names, as this process."""
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in ("-h", "--help"):
        summaries = {name: command.summary for name, command in COMMANDS.items()}
        print(f"usage: carpark_mj COMMAND ...\n\n{table(summaries)}\n")
        print("carpark_mj COMMAND --help lists the settings of each.")
        print("carpark_mj --version prints the version.")
        sys.exit(0)
    if name == "--version":
        print(f"carpark_mj {__version__}")
        sys.exit(0)
    if name not in COMMANDS:
        known = ", ".join(COMMANDS)
        reason = f"unknown command {name!r}; choose from {known}"
        print(f"carpark_mj: {reason}", file=sys.stderr)
        sys.exit(2)
    words = sys.argv[2:]
    if words and f"{name} {words[0]}" in COMMANDS:
        name, words = f"{name} {words[0]}", words[1:]
    sys.argv = [f"carpark_mj {name}", *words]  # as the help calls it
    enter(name, "carpark_mj.programs:run", name)


if __name__ == "__main__":
    main()
