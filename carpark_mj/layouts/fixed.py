"""Base of layouts whose lot does not depend on the key."""

import abc

import jax
import jax.numpy as jnp

from carpark_mj.config.layouts import LayoutConfig
from carpark_mj.layouts.types import Layout


class FixedLayoutConfig(LayoutConfig):
    """A config with one lot, its property `layout`."""

    @property
    @abc.abstractmethod
    def layout(self) -> Layout:
        """The lot, as numpy arrays."""

    @property
    def is_enclosed(self) -> bool:
        """False: walls need not enclose the ground."""
        return False

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return int(self.layout.bay_mask.sum())

    @property
    def min_goals(self) -> int:
        """The fewest bays that any key gives that are not reserved for parked cars."""
        return int(self.layout.goal_mask.sum())

    @property
    def is_random(self) -> bool:
        """False: the lot does not depend on the key."""
        return False

    def generate(self, key: jax.Array) -> Layout:
        """The lot; the key is unused."""
        del key
        return jax.tree.map(jnp.asarray, self.layout)
