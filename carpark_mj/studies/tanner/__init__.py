"""Tanner 2022: parking agents that learn to share a lot (arXiv 2206.13338)."""

from carpark_mj.config.observations import ENCODERS
from carpark_mj.studies.tanner.indices import IndexObservation
from carpark_mj.studies.tanner.observation import TannerObservation

ENCODERS.register("tanner", TannerObservation)
ENCODERS.register("indices", IndexObservation)
