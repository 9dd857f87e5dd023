"""Ends of episodes: parked, crashed, timed out or diverged."""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Literal

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import CheckedConfig, Count, NonNegative, Positive, data
from carpark_mj.extensions import Registry
from carpark_mj.geometry import axis_angle_error, box_inside, norm, rotate, wrap_angle
from carpark_mj.layouts.types import BayEnd
from carpark_mj.mdp.collisions import find_hits, find_hits_and_kerbs
from carpark_mj.types import NO_BAY, Events, Motion, State

WORLD_UNIT = 0.5625  # m; Tanner's car of 8 world units is then 4.5 m long


@dataclasses.dataclass(frozen=True)
class ParkedRule(CheckedConfig):
    """When a car counts as parked in its goal; all limits must hold, None = any.

    Attributes:
        offset: largest distance of centres along either axis of the bay [m].
        distance: largest distance of centres [m].
        from_end: largest distance of the centre from the bay's far end, along its
            axis; between its lines [m].
        inside_lines: the footprint must be within the bay's lines.
        heading: largest angle to the bay's axis, either way round [rad].
        speed: highest speed [m/s].
        test: a further condition, a JAX function of the cars' `Motion` (...) and the
            poses (..., 3), sizes (..., 2) [m] and ends (...) (None = either) of their
            goals that returns (...) bool.
        before_crash: an agent that parks in a step cannot crash in it.
        before_timeout: an agent that parks in its last step is not timed out.
        slack: least margin of a goal bay's length and width over a fleet car's [m].
    """

    offset: Positive | None = None
    distance: Positive | None = None
    from_end: Positive | None = None
    inside_lines: bool = False
    heading: Positive | None = None
    speed: Positive | None = None
    test: Callable[..., jax.Array] | None = None
    before_crash: bool = False
    before_timeout: bool = True
    slack: NonNegative = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        limits = ("offset", "distance", "from_end", "heading", "speed")
        given = [name for name in limits if getattr(self, name) is not None]
        if not (given or self.inside_lines or self.test):
            raise ValueError(
                f"a parked rule must have a limit, one of {', '.join(limits)}, "
                "inside_lines and test: without any a car is parked everywhere"
            )


PARKED_RULES: Registry[ParkedRule] = Registry(
    "parked rule", "carpark_mj.tasks.goal_pose"
)
# The reference implementation of Tanner 2022.
_TANNER = ParkedRule(offset=1.001 * WORLD_UNIT, before_crash=True)
PARKED_RULES.register("tanner", _TANNER)
_STRICT = ParkedRule(inside_lines=True, heading=math.radians(5.0), speed=0.2, slack=0.1)
PARKED_RULES.register("strict", _STRICT)
# ParkBench's 0.2 m and 3 degrees.
_PRECISE = ParkedRule(distance=0.2, heading=math.radians(3.0), speed=0.05)
PARKED_RULES.register("precise", _PRECISE)
# What both ask for, to train for either.
_EXACT = dataclasses.replace(_PRECISE, inside_lines=True, slack=0.1)
PARKED_RULES.register("exact", _EXACT)
# MetaDrive's arrival: 5 m about the end of the last lane.
PARKED_RULES.register("metadrive", ParkedRule(from_end=5.0))


@dataclasses.dataclass(frozen=True)
class End:
    """An end of episodes of one's own.

    `test` is a JAX function of the `State` at the end of a step that returns
    (num_agents,) bool. The outcome `crashed` terminates, `timed_out` truncates.
    """

    test: Callable[[State], jax.Array]
    outcome: Literal["crashed", "timed_out"] = "crashed"


ENDS: Registry[End] = Registry("end")


def find_rules(names: str) -> tuple[ParkedRule, ...]:
    """The parked rules of a comma-separated list."""
    return tuple(PARKED_RULES[name] for name in names.split(","))


@dataclasses.dataclass(frozen=True)
class EpisodeConfig(CheckedConfig):
    """When an agent's episode ends.

    Attributes:
        parked_rule: success rule, one of `carpark_mj.config.PARKED_RULES`; several,
            separated by commas, hold where any of them holds.
        max_steps: control steps until an episode is truncated (timeout).
        hitbox_scale: factor on the cars' lengths and widths in collision tests, in
            evaluations too. Walls and discs are not scaled.
        kerb_speed: highest speed [m/s] at which wheels may touch a kerb, which then
            stops the car; 0 = kerbs are walls. The body passes over kerbs.
        wheel_stops: distance of a wheel stop's face from the far end of every bay but
            parallel ones [m]; 0 = none. It is a kerb, neither observed nor drawn.
        ends: further ends, names in `carpark_mj.config.ENDS`.
        respawn: start a new episode of an agent at once when one ends; otherwise the
            agent brakes and stays where it is until the lot is reset.
        final_observation: add the observation before any respawn to `TimeStep`;
            off-policy learners need it.
    """

    parked_rule: str = "strict"
    max_steps: Count = 200
    hitbox_scale: Positive = data(1.0)
    kerb_speed: NonNegative = 0.0
    wheel_stops: NonNegative = 0.0
    ends: tuple[str, ...] = ()
    respawn: bool = True
    final_observation: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        find_rules(self.parked_rule)  # refuses unknown names
        for name in self.ends:
            ENDS[name]
        if self.wheel_stops and not self.kerb_speed:
            raise ValueError(
                f"wheel_stops {self.wheel_stops} needs a kerb_speed above 0 at which "
                "they may be touched"
            )

    @property
    def slack(self) -> float:
        """The largest of the parked rules [m]."""
        return max(rule.slack for rule in find_rules(self.parked_rule))


def is_parked(
    rule: str,
    motion: Motion,
    bay_pose: jax.Array,
    bay_size: jax.Array,
    bay_end: jax.Array | None = None,
) -> jax.Array:
    """Whether cars (...) stand parked in bays under a named rule, `PARKED_RULES`.

    Bays have poses (..., 3), sizes (..., 2) [m] and ends (...) int32, `BayEnd`: the
    wrong way round no rule holds; None = either end in all of them.
    """
    limits = PARKED_RULES[rule]
    parked = jnp.ones(motion.pose_w.shape[:-1], bool)
    offset = motion.xy - bay_pose[..., :2]
    if limits.offset is not None:
        # The study compares along its lot's axes. All its rows are axis-parallel, so
        # the bay's own axes give the same, and make the rule independent of the frame.
        along = jnp.abs(rotate(offset, -bay_pose[..., 2]))
        parked = parked & jnp.all(along < limits.offset, axis=-1)
    if limits.distance is not None:
        parked = parked & (norm(offset) < limits.distance)
    if limits.from_end is not None:
        own = rotate(offset, -bay_pose[..., 2])
        along = jnp.abs(own[..., 0] + bay_size[..., 0] / 2)
        between = jnp.abs(own[..., 1]) <= bay_size[..., 1] / 2
        parked = parked & (along < limits.from_end) & between
    if limits.inside_lines:
        parked = parked & box_inside(motion.pose_w, motion.size, bay_pose, bay_size)
    if limits.heading is not None:
        heading = axis_angle_error(motion.pose_w[..., 2] - bay_pose[..., 2])
        parked = parked & (heading < limits.heading)
    if bay_end is not None:
        nose_first = bay_end == BayEnd.NOSE_FIRST
        wanted = bay_pose[..., 2] + jnp.where(nose_first, jnp.pi, 0.0)
        off = jnp.abs(wrap_angle(motion.pose_w[..., 2] - wanted))
        parked = parked & ((bay_end == BayEnd.EITHER) | (off < jnp.pi / 2))
    if limits.speed is not None:
        parked = parked & (norm(motion.velocity_b) < limits.speed)
    if limits.test is not None:
        parked = parked & limits.test(motion, bay_pose, bay_size, bay_end)
    return parked


def detect_events(config: EpisodeConfig, state: State) -> Events:
    """Evaluates whether each agent's episode has ended after a step, and how.

    Divergence takes precedence over all other outcomes, then comes a crash, parking and
    a timeout, unless the parked rule says otherwise (`ParkedRule.before_crash`,
    `before_timeout`). Parking requires a goal, and of two agents in a bay that is the
    goal of both only the first parks.
    """
    layout, goal, motion = state.layout, state.goal, state.motion
    if config.kerb_speed:
        hits = find_hits_and_kerbs(config, state)
    else:
        hits = find_hits(state, config.hitbox_scale)
    hit = functools.reduce(jnp.logical_or, hits.values())
    late = state.step >= config.max_steps
    for end in (ENDS[name] for name in config.ends):
        if end.outcome == "crashed":
            hit = hit | end.test(state)
        else:
            late = late | end.test(state)
    diverged = state.active & ~motion.finite
    alive = state.active & motion.finite
    bays = layout.bay_pose[goal], layout.bay_size[goal]
    end = None if layout.bay_end is None else layout.bay_end[goal]
    rules = config.parked_rule.split(",")
    holds = {name: is_parked(name, motion, *bays, end) for name in rules}
    in_bay = functools.reduce(jnp.logical_or, holds.values())
    in_bay = in_bay & alive & (goal != NO_BAY)
    shared = jnp.tril(goal[:, None] == goal, k=-1)
    in_bay = in_bay & ~(shared & in_bay).any(axis=1)
    parked = jnp.zeros_like(in_bay)
    for name, held in holds.items():
        rule = PARKED_RULES[name]
        held = held if rule.before_crash else held & ~hit
        held = held if rule.before_timeout else held & ~late
        parked = parked | (in_bay & held)
    crashed = alive & hit & ~parked
    timed_out = alive & late & ~parked & ~crashed
    return Events(
        parked=parked,
        crashed=crashed,
        timed_out=timed_out,
        diverged=diverged,
        **{f"hit_{kind}": crashed & touched for kind, touched in hits.items()},
    )
