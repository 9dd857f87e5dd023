"""MetaDrive's multi-agent parking lot (Li et al. 2021, arXiv 2109.12674)."""

from carpark_mj.studies.metadrive import layouts

# isort: split
from carpark_mj.studies.metadrive import environments  # of what is named above

__all__ = ["environments", "layouts"]
