"""Families drawn by shortfall: new lots come from where training lags behind a target.

Where the number of agents varies, a lot's member of the mixture and its number of
agents are drawn together. Half of the probability follows the shares of the mixture and
is uniform over the numbers, half the shortfall of the rate of parked episodes of each
pair. Evaluation draws lots as the mixture says.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.config import LayoutConfig
from carpark_mj.layouts import member_shares
from carpark_mj.training.ppo.collect import Totals

MEMORY = 1000.0  # episodes of a pair over which its rate forgets
BY_SHORTFALL = 0.5  # part of the probability; the rest keeps all pairs in training


@dataclasses.dataclass(frozen=True)
class Families:
    """The members of a mixture whose lots are drawn by shortfall.

    Pairs are those of all members with all numbers of agents, member by member.

    Attributes:
        target: rate of parked episodes from which a pair has no shortfall; 0 = lots
            are drawn as the mixture says, and no member is listed.
        shares: the members by name, with their shares of the mixture.
        counts: numbers of agents that are drawn.
    """

    target: float
    shares: dict[str, float]
    counts: range

    def init(self) -> jax.Array:
        """Rates (pairs,) before the first episode: nothing is parked yet."""
        return jnp.zeros(len(self.shares) * len(self.counts), jnp.float32)

    def draw(
        self, rates: jax.Array, key: jax.Array, count: int
    ) -> tuple[jax.Array, jax.Array | None, jax.Array | None]:
        """Keys, members and numbers of agents (count,) of new lots, for `BraxParking`.

        Without a target the members are None: as the mixture says. So are the numbers,
        also where there is only one.

        Args:
            rates: (pairs,).
            key: consumed.
            count: lots.
        """
        if not self.target:
            return jax.random.split(key, count), None, None
        key, pair_key = jax.random.split(key)
        logits = jnp.log(self.probabilities(rates))
        pair = jax.random.categorical(pair_key, logits, shape=(count,))
        member, number = jnp.divmod(pair.astype(jnp.int32), len(self.counts))
        present = self.counts.start + number if len(self.counts) > 1 else None
        return jax.random.split(key, count), member, present

    def probabilities(self, rates: jax.Array) -> jax.Array:
        """How likely a new lot is of each pair (pairs,); they sum to 1."""
        shares = jnp.array(list(self.shares.values()), jnp.float32)
        shares = jnp.repeat(shares / len(self.counts), len(self.counts))
        shortfall = jnp.maximum(self.target - rates, 0.0)
        total = shortfall.sum()
        wanted = jnp.where(total > 0.0, shortfall / jnp.maximum(total, 1e-6), shares)
        return (1.0 - BY_SHORTFALL) * shares + BY_SHORTFALL * wanted

    def update(
        self, rates: jax.Array, info: Mapping[str, Any], totals: Totals, axis: str
    ) -> jax.Array:
        """Rates (pairs,) after an unroll; the same on all devices.

        Args:
            rates: running means of parked episodes before, exponential in the number of
                episodes.
            info: of the lots' Brax state, with what was drawn of them.
            totals: of the unroll.
            axis: name of the devices' axis.
        """
        pair = info["member"] * len(self.counts)
        if len(self.counts) > 1:
            pair += info["num_present"] - self.counts.start
        drove = pair == jnp.arange(rates.shape[0])[:, None]
        sums = jnp.stack([totals.episodes, totals.episode_metrics["parked"]])
        sums = jnp.where(drove, sums[:, None], 0.0).sum(axis=-1)
        episodes, parked = jax.lax.psum(sums, axis)
        kept = (1.0 - 1.0 / MEMORY) ** episodes
        return kept * rates + (1.0 - kept) * parked / jnp.maximum(episodes, 1.0)

    def metrics(self, rates: jax.Array) -> dict[str, jax.Array]:
        """Means of the rates (pairs,) by member and number of agents, for the log."""
        table = rates.reshape(len(self.shares), len(self.counts))
        by_name = dict(zip(self.shares, table.mean(axis=1), strict=True))
        found = {f"family/{name}": rate for name, rate in by_name.items()}
        if self.target and len(self.counts) > 1:
            by_count = zip(self.counts, table.mean(axis=0), strict=True)
            found |= {f"agents/{count}": rate for count, rate in by_count}
        return found


def make_families(target: float, layout: LayoutConfig, counts: range) -> Families:
    """The members of a layout's config, if their lots are drawn by shortfall."""
    return Families(target, member_shares(layout) if target else {}, counts)
