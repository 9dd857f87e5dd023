"""Runs a program of a paper or another extension: `carpark_mj study NAME …`."""

import sys
from collections.abc import Sequence

from carpark_mj.programs import STUDY_PROGRAMS, table
from carpark_mj.rendering.gl import choose_gl


def run(arguments: Sequence[str] | None = None) -> object:
    """Runs the program that the first argument names; returns what it returns.

    Raises:
        ValueError: there is no such program, or none at all.
    """
    choose_gl()  # before an extension imports MuJoCo
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not STUDY_PROGRAMS:
        raise ValueError(
            "no program is installed: those of the papers come with carpark_papers, "
            "`pip install ./papers` in a checkout of carpark_mj"
        )
    if not words or words[0] in ("-h", "--help"):
        print(f"usage: carpark_mj study NAME ...\n\n{table(STUDY_PROGRAMS)}")
        return 0
    program = STUDY_PROGRAMS[words[0]]
    sys.argv = [f"carpark_mj study {words[0]}", *words[1:]]
    return program.load()(words[1:])
