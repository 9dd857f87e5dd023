"""What a training carries and collects: its state, steps of all agents, lots."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.sharding import PartitionSpec

from carpark_mj.config import LayoutConfig
from carpark_mj.geometry import norm
from carpark_mj.layouts import member_shares
from carpark_mj.policy.brax import UInt64, compute_gae
from carpark_mj.training.ppo.variants import AXIS
from carpark_mj.types import State
from carpark_mj.wrappers.brax import BraxParking


@struct.dataclass
class TrainingState:
    """Everything an exact resume needs."""

    normalizer: Any  # running statistics of the observations
    policy: Any  # actor parameters
    average: Any  # their mean over the last updates, the policy that a run leaves
    value: Any  # critic parameters
    optimizer: Any  # Adam's moments, of all parameters as one vector
    key: jax.Array  # randomness of acting and shuffling
    update: jax.Array  # () int32 updates made
    steps: UInt64  # () agent steps made, of agents that were present
    skipped: jax.Array  # () int32 updates dropped because they were not finite
    seconds: jax.Array  # () float32 of `minutes` used, set by the host; 0 without
    family_rates: jax.Array  # see `Families`; (0,) without a target
    env: Any  # the Brax state of all lots


def state_specs() -> TrainingState:
    """Lots are divided over the devices, the rest is on all of them."""
    whole: Any = dict.fromkeys(TrainingState.__dataclass_fields__, PartitionSpec())
    return TrainingState(**whole | {"env": PartitionSpec(AXIS)})


def no_steps() -> UInt64:
    """The count of agent steps before the first; 32 bits would overflow."""
    count: Any = UInt64  # its fields are hidden from Pyright
    return count(0, 0)


def count_steps(state: TrainingState) -> np.ndarray:
    """Agent steps (runs,) int64 that every run has made; of one alone (1,)."""
    return np.ravel(state.steps.to_numpy()).astype(np.int64)


# `(observation, key) -> (action, extras)` with Brax's extras of a stochastic policy.
Actor = Callable[[jax.Array, jax.Array], tuple[jax.Array, dict[str, Any]]]
# Actions (lots * agents, size) in the states of lots.
Teacher = Callable[[Any], jax.Array]


@struct.dataclass
class Rollout:
    """What an update learns from; arrays (time, agents, ...) unless stated."""

    observation: jax.Array  # what the agents saw before a step
    raw_action: jax.Array  # actions as drawn, before tanh
    log_prob: jax.Array  # their log-densities under the policy that drew them
    reward: jax.Array  # of the step
    terminated: jax.Array  # 1.0 where the step ended an episode for good
    truncated: jax.Array  # 1.0 where it was cut off, by a timeout for instance
    final_observation: jax.Array  # (agents, size) after the last step
    weight: jax.Array | None = None  # 0.0 of steps of absent agents; None = all 1.0
    advice: jax.Array | None = None  # actions of a teacher, if there is one
    near: jax.Array | None = None  # (time, agents, agents of a lot), see `neighbours`


@struct.dataclass
class Totals:
    """Sums over the steps of a rollout, (agents,) each."""

    episodes: jax.Array  # episodes that ended
    episode_metrics: dict[str, jax.Array]  # sums of their metrics, by name
    reward_terms: dict[str, jax.Array]  # sums over all steps, by name


def collect(
    env: BraxParking,
    env_state: Any,
    actor: Actor,
    key: jax.Array,
    length: int,
    scales: Mapping[str, jax.Array],
    with_neighbours: bool = False,
    teacher: Teacher | None = None,
) -> tuple[Any, Rollout, Totals]:
    """Drives the agents of all lots for `length` steps; gives the state after as well.

    `scales` () are factors on reward terms, by name, in the rewards to learn from, not
    in those reported. The rollout has `near` on request, and advice with a teacher.
    """

    def step(carry: Any, key: jax.Array) -> tuple[Any, Any]:
        state, totals = carry
        action, drawn = actor(state.obs, key)
        after = env.step(state, action)
        info = after.info
        done = info["episode_done"]
        ended = {name: x * done for name, x in info["episode_metrics"].items()}
        sums = Totals(done, ended, info["reward_terms"])
        totals = jax.tree.map(jnp.add, totals, sums)
        changes = [(x - 1.0) * info["reward_terms"][name] for name, x in scales.items()]
        reward = after.reward + sum(changes, jnp.zeros(()))
        taken = (
            state.obs,
            drawn["raw_action"],
            drawn["log_prob"],
            reward,
            done - info["truncation"],
            info["truncation"],
        )
        lots: Any = state.pipeline_state
        advice = teacher(lots) if teacher is not None else None
        near = neighbours(lots) if with_neighbours else None
        return (after, totals), (taken, state.info["present"], advice, near)

    info = env_state.info
    zeros = jax.tree.map(
        jnp.zeros_like,
        Totals(info["episode_done"], info["episode_metrics"], info["reward_terms"]),
    )
    (env_state, totals), (taken, present, advice, near) = jax.lax.scan(
        step, (env_state, zeros), jax.random.split(key, length)
    )
    rollout = Rollout(
        *taken,
        final_observation=env_state.obs,
        weight=present,
        advice=advice,
        near=near,
    )
    return env_state, rollout, totals


def drop_absent(
    rollout: Rollout, count: int, key: jax.Array
) -> tuple[Rollout, jax.Array]:
    """The rollout of `count` agents, and which are kept.

    Absent ones are dropped first, those that waited for room in some steps next, then
    others at random.
    """
    present = rollout.weight.mean(axis=0) if rollout.weight is not None else 1.0
    luck = jax.random.uniform(key, rollout.reward.shape[1:])
    kept = jnp.argsort(luck - present)[:count]
    final_observation = rollout.final_observation[kept]
    rollout = dataclasses.replace(rollout, final_observation=jnp.zeros(()))
    rollout = jax.tree.map(lambda x: x[:, kept] if x.ndim else x, rollout)
    return dataclasses.replace(rollout, final_observation=final_observation), kept


# m between centres; measured with it in docs/ablations.md, no other was tried.
RANGE = 15.0


def neighbours(lots: State) -> jax.Array:
    """(lots * agents, agents) bool, which other agents of its lot are near each agent.

    Their advantages may be shared, see `CurriculumConfig.neighbour_share`. Not their
    rewards: an agent that parks would lose these, and learn to stay. Advantages are 0
    on average, wherever it is.
    """
    xy, present = lots.motion.xy, lots.active
    num_agents = xy.shape[1]
    near = norm(xy[:, :, None] - xy[:, None]) <= RANGE
    near &= present[:, :, None] & present[:, None] & ~jnp.eye(num_agents, dtype=bool)
    return near.reshape(-1, num_agents)


def neighbours_mean(near: jax.Array, values: jax.Array) -> jax.Array:
    """Mean (time, lots * agents) of the neighbours' values; 0 where there is none.

    `near` is (time, lots * agents, agents), see `neighbours`.
    """
    num_agents = near.shape[-1]
    lots = values.reshape(len(values), -1, 1, num_agents)
    theirs = jnp.where(near.reshape(*lots.shape[:2], -1, num_agents), lots, 0.0)
    total = theirs.sum(axis=-1).reshape(values.shape)
    return total / jnp.maximum(near.sum(axis=-1), 1)


def compute_advantages(
    rollout: Rollout,
    values: jax.Array,
    final_value: jax.Array,
    discount: Any,
    gae_lambda: float,
) -> tuple[jax.Array, jax.Array]:
    """Advantages and value targets (time, agents) of Brax's GAE, without gradients.

    A truncated step has advantage 0 and the critic's own value as target, for what
    comes after it is not known; no loss counts it. `values` are (time, agents), and
    `final_value` (agents,) is of the observation after the last step.
    """
    targets, advantages = compute_gae(
        truncation=rollout.truncated,
        termination=rollout.terminated,
        rewards=rollout.reward,
        values=values,
        bootstrap_value=final_value,
        lambda_=gae_lambda,
        discount=discount,
    )
    return advantages, targets


MEMORY = 1000.0  # episodes of a pair over which its rate forgets
BY_SHORTFALL = 0.5  # part of the probability; the rest keeps all pairs in training


@dataclasses.dataclass(frozen=True)
class Families:
    """The members of a mixture whose lots are drawn by shortfall from a target.

    A lot's member of the mixture and, where it varies, its number of agents are drawn
    together: pairs are those of all members with all numbers, member by member. Half of
    the probability follows the shares of the mixture and is uniform over the numbers,
    half the shortfall of each pair's rate of parked episodes. Evaluation draws lots as
    the mixture says.
    """

    # Rate of parked episodes from which a pair has no shortfall; 0 = lots are drawn as
    # the mixture says, and no member is listed.
    target: float
    shares: dict[str, float]  # the members by name, with their shares of the mixture
    counts: range  # numbers of agents that are drawn

    def init(self) -> jax.Array:
        """Rates (pairs,) before the first episode: nothing is parked yet."""
        return jnp.zeros(len(self.shares) * len(self.counts), jnp.float32)

    def draw(
        self, rates: jax.Array, key: jax.Array, count: int
    ) -> tuple[jax.Array, jax.Array | None, jax.Array | None]:
        """Keys, members and numbers of agents (count,) of new lots, for `BraxParking`.

        Without a target the members are None: as the mixture says. So are the numbers,
        also where there is only one. `rates` are (pairs,).
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
        """Rates (pairs,) after an unroll with some totals; the same on all devices.

        They are running means of parked episodes, exponential in the number of
        episodes. An episode counts as much as it has steps: lots where it takes long
        see fewer episodes, and would hardly count. `info` is that of the lots' Brax
        state, `axis` that of the devices.
        """
        pair = info["member"] * len(self.counts)
        if len(self.counts) > 1:
            pair += info["num_present"] - self.counts.start
        drove = pair == jnp.arange(rates.shape[0])[:, None]
        steps, parked = (totals.episode_metrics[name] for name in ("length", "parked"))
        parked = steps * parked / jnp.maximum(totals.episodes, 1.0)
        sums = jnp.stack([totals.episodes, steps, parked])
        sums = jnp.where(drove, sums[:, None], 0.0).sum(axis=-1)
        episodes, steps, parked = jax.lax.psum(sums, axis)
        kept = (1.0 - 1.0 / MEMORY) ** episodes
        return kept * rates + (1.0 - kept) * parked / jnp.maximum(steps, 1.0)

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
