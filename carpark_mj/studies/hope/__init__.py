"""HOPE: cases of graded difficulty (Jiang et al. 2024, arXiv 2405.20579)."""

from carpark_mj.studies.hope import layouts

# isort: split
from carpark_mj.studies.hope import environments, programs  # of what is named above

__all__ = ["environments", "layouts", "programs"]
