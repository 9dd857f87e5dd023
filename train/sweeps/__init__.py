"""Sweeps: every combination of some settings, trained as jobs through submitit."""

import importlib.util
import sys

if importlib.util.find_spec("submitit") is None:
    print('sweeps need submitit: pip install ".[sweep]"', file=sys.stderr)
    sys.exit(2)
