"""The reward: named terms of a step, weighted and added.

`TERMS` are the library's, `GOAL_TERMS` those of goals that agents choose, and
`RewardConfig.extra` adds any of `REWARD_TERMS`. The order in which they are added is
that of `term_weights`.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Callable, Container, Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import (
    Bounds,
    CheckedConfig,
    Finite,
    NonNegative,
    data,
    is_finite,
    is_off,
    require_number,
)
from carpark_mj.extensions import Registry
from carpark_mj.geometry import norm
from carpark_mj.layouts.routes import route_to
from carpark_mj.mdp.collisions import agent_clearance
from carpark_mj.mdp.goals import target_bay
from carpark_mj.mdp.progress import (
    direction_of_travel,
    effort,
    goal_potential,
    is_nearer,
    mix_in_maneuver,
)
from carpark_mj.types import NO_BAY, Transition

if TYPE_CHECKING:
    from carpark_mj.config import EnvConfig

CLOSENESS_RANGE = 3.0  # m, clearance between agents below which they are too close
STANDS = 0.1  # m/s, speed below which a car stands [est]
NEAR = 8.0  # m between centres: two cars and the gap to turn between them [est]
TOLERANCE = 1e-9  # by which Tanner's rule (3.5) may fail, for 0.1 + 0.2 is not 0.3


@dataclasses.dataclass(frozen=True)
class RewardTerm(CheckedConfig):
    """A term of the reward; its weight is a setting of `RewardConfig`.

    Attributes:
        value: the term without weight and sign: a function of an `EnvConfig` and a
            `Transition` that returns (num_agents,), in JAX. Other arguments are numbers
            with defaults. Where its weight is known to be 0 it is not called.
        sign: 1 = reward, -1 = penalty.
        per_step: divide the weight by `EpisodeConfig.max_steps`, so that a full episode
            adds up to it.
        fixed: parameters that decide what is computed. All other numbers of a term may
            be traced, and differ between runs side by side.
        most: largest weight.
    """

    value: Callable[..., Any]
    sign: float = 1.0
    per_step: bool = False
    fixed: tuple[str, ...] = ()
    most: float = math.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, default in self.parameters.items():
            if not is_finite(default):
                raise ValueError(
                    f"parameter {name} of a reward term must have a default, a number"
                )

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters' defaults by name."""
        arguments = list(inspect.signature(self.value).parameters.values())[2:]
        return {argument.name: argument.default for argument in arguments}

    @property
    def meaning(self) -> str:
        """The first line of the function's docstring."""
        return (inspect.getdoc(self.value) or "").partition("\n")[0]


# Terms beyond `TERMS` and `GOAL_TERMS`, for `RewardConfig.extra`.
REWARD_TERMS: Registry[RewardTerm] = Registry(
    "reward term", "carpark_mj.tasks.goal_pose", "carpark_mj.mdp.people"
)


def term_settings(name: str) -> dict[str, float | None]:
    """Defaults of a registered term's settings by name; its weight has none."""
    parameters = REWARD_TERMS[name].parameters.items()
    return {name: None, **{f"{name}.{key}": default for key, default in parameters}}


class ExtraTerms(dict[str, float]):
    """Settings of registered terms by name, in the order in which terms are added."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, dict) and list(self.items()) == list(other.items())

    def __hash__(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return hash(tuple(self.items()))

    def is_fixed(self, key: str) -> bool:
        """Whether a setting of a term decides what is computed."""
        name, _, parameter = key.partition(".")
        return parameter in REWARD_TERMS[name].fixed

    def check(self, taken: Container[str]) -> None:
        """Refuses settings of unregistered terms and names that are taken."""
        for key, value in self.items():
            name, _, parameter = key.partition(".")
            if name in taken:
                raise ValueError(
                    f"extra cannot have {name!r}: the library has such a term"
                )
            if key not in (known := term_settings(name)):
                raise ValueError(
                    f"reward term {name!r} has no parameter {parameter!r}: its "
                    f"settings are {', '.join(known)}"
                )
            weights = Bounds(ge=0.0, le=REWARD_TERMS[name].most)
            require_number(key, value, weights if key == name else Bounds())
            if name not in self:
                raise ValueError(f"{key} needs {name}, the weight of the term")


@dataclasses.dataclass(frozen=True)
class GoalRewards(CheckedConfig):
    """Rewards for choices of dynamic goals.

    They are signed rewards of a step, not divided by the episode length. The defaults
    are from Tanner 2022, table C.10 (e is exploring, p and p' are bays).

    Attributes:
        continue_explore: reward for continuing to explore, r(e->e).
        stop_explore: reward for choosing a bay while exploring, r(e->p).
        continue_goal: reward for keeping the bay, r(p->p).
        change_goal: reward for choosing another bay, r(p->p').
        stop_goal: reward for giving up the bay to explore, r(p->e); None = r(p->p') -
            r(e->p), as the study's rule (3.5) requires. It is also paid when a goal is
            lost because it is no longer tracked, as in the reference implementation.
    """

    continue_explore: Finite = data(-0.002)
    stop_explore: Finite = data(0.0)
    continue_goal: Finite = data(0.0)
    change_goal: Finite = data(-0.05)
    stop_goal: Finite | None = data(None)

    @property
    def stop(self) -> float:
        """r(p->e), given or computed."""
        if self.stop_goal is None:
            return self.change_goal - self.stop_explore
        return self.stop_goal

    def check(self) -> None:
        """Raises unless the rewards satisfy Tanner's (3.5), and with it (3.6).

        The study asks for a negative `change_goal`, but publishes a run with 0.
        """
        explore, change = self.continue_explore, self.change_goal
        if explore >= 0.0 or change > 0.0:
            raise ValueError(
                "with dynamic goals reward.goals.continue_explore must be negative and "
                f"change_goal at most 0, not {explore} and {change}"
            )
        if abs(self.stop + self.stop_explore - change) > TOLERANCE:
            raise ValueError(
                "reward.goals must have change_goal = stop_goal + stop_explore, not "
                f"{change} = {self.stop} + {self.stop_explore}"
            )


if TYPE_CHECKING:
    Extra = Mapping[str, float]
else:
    Extra = ExtraTerms


@dataclasses.dataclass(frozen=True)
class RewardConfig(CheckedConfig):
    """Weights of the reward terms.

    All weights are non-negative, and 0 disables a term; penalties are subtracted. "Per
    step" weights are divided by `EpisodeConfig.max_steps`, so that they add up to the
    weight over a full episode.

    Attributes:
        park: reward for parking, once.
        crash: penalty for crashing, once.
        time: penalty per step.
        progress: reward per metre gained towards the goal; negative when moving away.
        route: measure the distances of `progress` and `alignment` along the lanes
            (`carpark_mj.layouts.routes`) instead of straight; fixed goals only.
        reeds_shepp_reach: distance to the goal [m] within which `progress` measures the
            shortest Reeds-Shepp path for the car's turning circle, nose in or out; it
            is mixed in linearly down to a quarter of this distance. 0 = never.
        alignment: reward per radian of misalignment with the goal's axis removed,
            fading with the distance to the goal; negative when it grows.
        closeness: penalty per step, times 1 - clearance to the nearest other agent /
            3 m, not below 0.
        extra: weights of terms in `REWARD_TERMS` by name, as in `{"haste": 0.01}`, and
            their parameters, as in `{"haste": 0.01, "haste.above": 2.0}`.
        goals: signed rewards for choosing and losing goals; dynamic goals only.
    """

    park: NonNegative = data(4.0)
    crash: NonNegative = data(2.5)
    time: NonNegative = data(1.0)
    progress: NonNegative = data(0.2)
    route: bool = False
    reeds_shepp_reach: NonNegative = data(0.0)
    alignment: NonNegative = data(0.5)
    closeness: NonNegative = data(15.0)
    extra: Extra = dataclasses.field(default_factory=ExtraTerms)
    goals: GoalRewards = dataclasses.field(default_factory=GoalRewards)

    def __post_init__(self) -> None:
        if isinstance(self.extra, Mapping):  # pyright: ignore[reportUnnecessaryIsInstance]
            object.__setattr__(self, "extra", ExtraTerms(self.extra))
        super().__post_init__()
        own = (*dataclasses.fields(self), *dataclasses.fields(GoalRewards))
        names = {field.name for field in own}
        ExtraTerms(self.extra).check(names | {"lost_goal", "bad_goal"})

    def parameters(self, name: str) -> dict[str, float]:
        """Parameters of a term that `extra` gives other values than the defaults."""
        start, given = f"{name}.", self.extra.items()
        return {k.removeprefix(start): x for k, x in given if k.startswith(start)}


REWARDS: Registry[RewardConfig] = Registry("reward", "carpark_mj.tasks.goal_pose")
REWARDS.register("shaped", RewardConfig())


def term_weights(config: EnvConfig) -> dict[str, float]:
    """Weights of all terms by name, which may be traced; 0 where a term is off."""
    reward = config.reward
    weights: dict[str, float] = {name: getattr(reward, name) for name in TERMS}
    # Its two weights are in the potential.
    unpaid = is_off(reward.progress) and is_off(reward.alignment)
    weights["progress"] = 0.0 if unpaid else 1.0
    weights |= {key: w for key, w in reward.extra.items() if "." not in key}
    return weights | (goal_weights(config) if config.goals.dynamic else {})


def reward_terms(config: EnvConfig, transition: Transition) -> dict[str, jax.Array]:
    """The reward of a step, term by term.

    (num_agents,) float32 by the names of `term_weights`, weights and signs applied; 0
    for agents that had finished before, or whose physics diverged. Terms whose weights
    are known to be 0 are not computed.
    """
    pays = transition.before.active & ~transition.events.diverged
    paid: dict[str, jax.Array] = {}
    for name, weight in term_weights(config).items():
        if is_off(weight):
            paid[name] = jnp.zeros(pays.shape, jnp.float32)
            continue
        term = TERMS.get(name) or GOAL_TERMS.get(name) or REWARD_TERMS[name]
        share = 1.0 / config.episode.max_steps if term.per_step else 1.0
        value = term.value(config, transition, **config.reward.parameters(name))
        reward = term.sign * weight * share * value
        paid[name] = jnp.where(pays, reward, 0.0).astype(jnp.float32)
    return paid


def _potential(
    config: EnvConfig, transition: Transition, pose_w: jax.Array
) -> jax.Array:
    """Potential (num_agents,) of poses (num_agents, 3) for the goals of the step."""
    weights, state, target = config.reward, transition.after, transition.target_pose
    reach, one_way = weights.reeds_shepp_reach, transition.one_way
    distance = norm(pose_w[:, :2] - target[:, :2])
    if weights.route:
        goal = transition.goal
        distance = route_to(state.routes, state.layout, pose_w[:, :2], goal).length
    if not is_off(reach):
        car = transition.before.physics.vehicle
        distance = mix_in_maneuver(reach, distance, car, pose_w, target, one_way)
    return goal_potential(weights, pose_w, target, distance, one_way)


def _progress(config: EnvConfig, transition: Transition) -> jax.Array:
    """Progress (num_agents,) towards the goals; its weights are in the potential."""
    if transition.goal_events is not None:
        return dynamic_progress(config, transition)
    after, before = transition.after.motion.pose_w, transition.before.motion.pose_w
    potential = jax.vmap(lambda pose_w: _potential(config, transition, pose_w))
    ended, started = jnp.unstack(potential(jnp.stack([after, before])))
    return ended - started


def dynamic_progress(config: EnvConfig, transition: Transition) -> jax.Array:
    """Progress (num_agents,) when goals change; no cycle of goals is profitable.

    Progress is measured towards the goal chosen in the step. Exploring agents get no
    positive progress, but moving away from the nearest tracked bay costs as much as
    approaching it would have paid; otherwise an agent could approach with a goal and
    leave without one, for ever. Changing to a farther goal costs the potential lost, a
    nearer goal pays nothing. So the terms of a loop that ends in the pose and with the
    goal it began with add up to at most 0.
    """
    before, layout = transition.before, transition.before.layout
    tracked, weights = before.tracked_bays, config.reward
    assert tracked is not None
    pose, after_pose = before.motion.pose_w, transition.after.motion.pose_w
    old, _ = target_bay(layout, before.goal, tracked, pose[:, :2])
    new, any_bay = target_bay(layout, transition.goal, tracked, pose[:, :2])
    exploring = transition.goal == NO_BAY
    one_way = layout.one_way

    def potential(pose: jax.Array, bay: jax.Array) -> jax.Array:
        only = None if one_way is None else one_way[bay]
        return goal_potential(weights, pose, layout.parked_pose[bay], one_way=only)

    # Of an explorer's nearest bay at the end: another may have become that.
    target, only = transition.target_pose, transition.one_way
    ended = goal_potential(weights, after_pose, target, one_way=only)
    start = potential(pose, new)
    moved = jnp.where(exploring, ended, potential(after_pose, new)) - start
    moved = jnp.where(exploring, jnp.minimum(moved, 0.0), moved)
    switched = start - potential(pose, old)
    return jnp.where(any_bay, moved + jnp.minimum(switched, 0.0), 0.0)


def _closeness(_: EnvConfig, transition: Transition) -> jax.Array:
    """Share (num_agents,) of the range by which the nearest agent is too close."""
    gap = agent_clearance(transition.after.motion) / CLOSENESS_RANGE
    return jnp.maximum(1.0 - gap, 0.0)


TERMS = {
    "park": RewardTerm(lambda config, step: step.events.parked),
    "crash": RewardTerm(lambda config, step: step.events.crashed, sign=-1),
    "time": RewardTerm(lambda config, step: 1.0, sign=-1, per_step=True),
    "progress": RewardTerm(_progress),
    "closeness": RewardTerm(_closeness, sign=-1, per_step=True),
}


def goal_weights(config: EnvConfig) -> dict[str, float]:
    """Weights of `GOAL_TERMS`; `bad_goal` only where there are bad goals."""
    pay, scheme = config.reward.goals, config.giving_way
    names = ("continue_explore", "stop_explore", "continue_goal", "change_goal")
    weights: dict[str, float] = {name: getattr(pay, name) for name in names}
    bad = {} if scheme.context is None else {"bad_goal": scheme.bad_goal}
    return weights | {"stop_goal": pay.stop, "lost_goal": pay.stop} | bad


def _event(name: str) -> RewardTerm:
    """A term that is paid when something happens to a goal."""
    return RewardTerm(lambda config, step: getattr(step.goal_events, name))


def _keeps_bad(config: EnvConfig, step: Transition) -> jax.Array:
    """Whether agents (num_agents,) keep goals that the scheme says to give up."""
    goals, context = step.goal_events, config.giving_way.context
    assert goals is not None
    bad = False if context is None else goals.contexts[context]
    return goals.continue_goal & bad


def _keeps_good(config: EnvConfig, step: Transition) -> jax.Array:
    """Whether agents (num_agents,) keep other goals."""
    assert step.goal_events is not None
    return step.goal_events.continue_goal & ~_keeps_bad(config, step)


GOAL_TERMS = {
    "continue_explore": _event("continue_explore"),
    "stop_explore": _event("stop_explore"),
    "continue_goal": RewardTerm(_keeps_good),
    "change_goal": _event("change_goal"),
    "stop_goal": _event("stop_goal"),
    "lost_goal": _event("lost_untracked"),
    "bad_goal": RewardTerm(_keeps_bad),
}


def _approach(_: EnvConfig, transition: Transition) -> jax.Array:
    """Reward per step that ends nearer to the goal, penalty per step that does not."""
    before, after = transition.before.motion, transition.after.motion
    nearer = is_nearer(before.xy, after.xy, transition.target_pose[:, :2])
    paid = jnp.where(nearer, 1.0, -1.0)
    goals = transition.goal_events
    return paid if goals is None else jnp.where(goals.exploring, 0.0, paid)


def _smoothness(
    config: EnvConfig, transition: Transition, by_speed: float = 0.0
) -> jax.Array:
    """Penalty per step, times the steering change as a share of the largest.

    With `by_speed` the penalty is multiplied by the speed as a share of the top speed.
    """
    turn, speed = effort(config, transition)
    return turn * speed if by_speed else turn


def _reverse(_: EnvConfig, transition: Transition) -> jax.Array:
    """Penalty per step in reverse."""
    return direction_of_travel(transition.after.motion) < 0.0


def _yielding(config: EnvConfig, transition: Transition) -> jax.Array:
    """Time penalty of the step if the car stands while another drives within 8 m.

    Neither's episode ends with the step. Two cars that stand earn nothing, and no car
    earns more than the penalty: a weight is at most 1.
    """
    motion = transition.after.motion
    goes_on = transition.before.active & ~transition.events.done
    drives = jnp.abs(motion.speed) >= STANDS
    near = norm(motion.xy[:, None] - motion.xy) <= NEAR
    yields = goes_on & ~drives & (near & goes_on & drives).any(axis=1)
    return yields * (config.reward.time / config.episode.max_steps)


def _automatic_braking(_: EnvConfig, transition: Transition) -> jax.Array:
    """Penalty for each step in which automatic brakes override the driver."""
    braked = transition.braked
    return jnp.array(0.0) if braked is None else braked


REWARD_TERMS.register("approach", RewardTerm(_approach, per_step=True))
_SMOOTHNESS = RewardTerm(_smoothness, -1, per_step=True, fixed=("by_speed",))
REWARD_TERMS.register("smoothness", _SMOOTHNESS)
REWARD_TERMS.register("reverse", RewardTerm(_reverse, -1, per_step=True))
REWARD_TERMS.register("yielding", RewardTerm(_yielding, most=1.0))
REWARD_TERMS.register("automatic_braking", RewardTerm(_automatic_braking, -1))
