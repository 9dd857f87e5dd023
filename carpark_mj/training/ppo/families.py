"""Families drawn by shortfall: new lots come from where training lags behind a target.

Half of the probability follows the shares of the mixture, half the shortfall of each
member's rate of parked episodes. Evaluation draws lots as the mixture says.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import LayoutConfig
from carpark_mj.layouts import member_shares
from carpark_mj.training.ppo.collect import Totals

MEMORY = 1000.0  # episodes of a member over which its rate forgets
BY_SHORTFALL = 0.5  # part of the probability; the rest keeps all members in training


@dataclasses.dataclass(frozen=True)
class Families:
    """The members of a mixture whose lots are drawn by shortfall.

    Attributes:
        target: rate of parked episodes from which a member has no shortfall; 0 = lots
            are drawn as the mixture says, and no member is listed.
        shares: the members by name, with their shares of the mixture.
    """

    target: float
    shares: dict[str, float]

    def init(self) -> jax.Array:
        """Rates (members,) before the first episode: nothing is parked yet."""
        return jnp.zeros(len(self.shares), jnp.float32)

    def draw(
        self, rates: jax.Array, key: jax.Array, count: int
    ) -> tuple[jax.Array, jax.Array | None]:
        """Keys (count,) and members (count,) int32 of new lots, for `BraxParking`.

        Without a target the members are None: as the mixture says.

        Args:
            rates: (members,).
            key: consumed.
            count: lots.
        """
        if not self.target:
            return jax.random.split(key, count), None
        key, member_key = jax.random.split(key)
        logits = jnp.log(self.probabilities(rates))
        member = jax.random.categorical(member_key, logits, shape=(count,))
        return jax.random.split(key, count), member.astype(jnp.int32)

    def probabilities(self, rates: jax.Array) -> jax.Array:
        """How likely a new lot is of each member (members,); they sum to 1."""
        shares = jnp.array(list(self.shares.values()), jnp.float32)
        shortfall = jnp.maximum(self.target - rates, 0.0)
        total = shortfall.sum()
        wanted = jnp.where(total > 0.0, shortfall / jnp.maximum(total, 1e-6), shares)
        return (1.0 - BY_SHORTFALL) * shares + BY_SHORTFALL * wanted

    def update(
        self, rates: jax.Array, member: jax.Array, totals: Totals, axis: str
    ) -> jax.Array:
        """Rates (members,) after an unroll; the same on all devices.

        Args:
            rates: running means of parked episodes before, exponential in the number of
                episodes.
            member: (agents,) int32 which one each drove in.
            totals: of the unroll.
            axis: name of the devices' axis.
        """
        drove = member == jnp.arange(rates.shape[0])[:, None]
        sums = jnp.stack([totals.episodes, totals.episode_metrics["parked"]])
        sums = jnp.where(drove, sums[:, None], 0.0).sum(axis=-1)
        episodes, parked = jax.lax.psum(sums, axis)
        kept = (1.0 - 1.0 / MEMORY) ** episodes
        return kept * rates + (1.0 - kept) * parked / jnp.maximum(episodes, 1.0)

    def metrics(self, rates: jax.Array) -> dict[str, jax.Array]:
        """The rates (members,) by name, for the log."""
        return {f"family/{name}": rates[k] for k, name in enumerate(self.shares)}


def make_families(target: float, layout: LayoutConfig) -> Families:
    """The members of a layout's config, if their lots are drawn by shortfall.

    Raises:
        ValueError: there is a target, but the layout is no mixture.
    """
    shares = member_shares(layout) if target else {}
    if len(shares) == 1:
        raise ValueError(
            f"curriculum.target_rate {target} needs a mixture of layouts, not "
            f"{next(iter(shares))!r} alone"
        )
    return Families(target, shares)
