"""A mixture of layouts: every lot is of one of several families."""

import dataclasses
from collections.abc import Callable
from typing import Annotated, Any

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import Bounds
from carpark_mj.layouts import schematics
from carpark_mj.layouts.base import LayoutConfig, register_layout
from carpark_mj.layouts.lot import AngledConfig
from carpark_mj.layouts.standards import Entry
from carpark_mj.layouts.types import Layout, layout_maxima, pad_layout


@dataclasses.dataclass(frozen=True)
class MixtureConfig(LayoutConfig):
    """A mixture: every key draws a family first, then one of its lots.

    All its lots are padded to the same numbers of rows, so that a batch may hold lots
    of different families, and all keys share one compiled program.

    Attributes:
        members: configs of the families.
        weights: how often each is drawn, in proportion; empty = equally often.
    """

    members: tuple[LayoutConfig, ...] = (
        schematics.SQUARE_COMPACT,
        schematics.StreetConfig(),
        schematics.StreetParallelConfig(),
        AngledConfig(),
    )
    weights: Annotated[tuple[float, ...], Bounds(gt=0.0)] = ()
    family: str = "mixture"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.members:
            raise ValueError("members of a mixture must be one config or more, not ()")
        if self.weights and len(self.weights) != len(self.members):
            raise ValueError(
                f"weights must be one for each of the {len(self.members)} members, "
                f"not {self.weights}"
            )

    @property
    def parts(self) -> tuple[LayoutConfig, ...]:
        """The members, and the members of mixtures among them."""
        return sum((member.parts for member in self.members), ())

    @property
    def shares(self) -> tuple[tuple[LayoutConfig, float], ...]:
        """The members, each with its share of the lots."""
        total, pairs = sum(self._weights), zip(self.members, self._weights, strict=True)
        return tuple((member, weight / total) for member, weight in pairs)

    @property
    def _weights(self) -> tuple[float, ...]:
        return self.weights or (1.0,) * len(self.members)

    @property
    def is_enclosed(self) -> bool:
        """Whether walls keep cars within all of its lots."""
        return all(member.is_enclosed for member in self.members)

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return min(member.min_bays for member in self.members)

    @property
    def min_goals(self) -> int:
        """The fewest bays for goals that any key gives."""
        return min(member.min_goals for member in self.members)

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Of all members; not known if one does not know."""
        entries = [member.entries for member in self.members]
        return sum(entries, ()) if all(entries) else ()

    def generate(self, key: jax.Array) -> Layout:
        """Draws a family, then a lot of it."""
        weights = jnp.array(self._weights, jnp.float32)
        pick_key, lot_key = jax.random.split(key)
        pick = jax.random.categorical(pick_key, jnp.log(weights))
        return self.generate_member(pick, lot_key)

    def generate_member(self, member: jax.Array, key: jax.Array) -> Layout:
        """Draws a lot of one member, () int32, padded like all lots of the mixture."""
        numbers: dict[Any, list[Any]] = {}  # by what draws lots of them
        places: list[tuple[int, int]] = []  # of the members: which draw, which numbers
        for draw, own in (config.split() for config in self.members):
            numbers.setdefault(draw, []).append(own)
            places.append(([*numbers].index(draw), len(numbers[draw]) - 1))
        draws = {draw: jax.jit(draw) for draw in numbers}  # traced once
        shapes = [jax.eval_shape(draws[x], numbers[x][0], key) for x in draws]
        maxima = layout_maxima(shapes)

        def padded(draw: Any) -> Callable[[jax.Array], Layout]:
            def drawn(row: jax.Array) -> Layout:
                own = jax.tree.map(lambda *x: jnp.array(x)[row], *numbers[draw])
                return pad_layout(draws[draw](own, key), maxima)

            return drawn

        draw, row = jnp.array(places)[member]
        lot = jax.lax.switch(draw, [*map(padded, numbers)], row)
        return jax.lax.optimization_barrier(lot)  # one branch alone is no switch


register_layout("mixture", MixtureConfig())
