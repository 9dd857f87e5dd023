"""What is visible at one instant of a recording."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from carpark_mj.config.observations import Tracked
from carpark_mj.geometry import nearest
from carpark_mj.geometry.obstacles import Group, take
from carpark_mj.layouts.types import Layout
from carpark_mj.rendering.recording import Recording
from carpark_mj.types import NO_BAY, OUTCOMES

FLASH_SECONDS = 0.8  # how long an ended episode flashes
STANDING = 0.1  # m/s, slower cars stand


@dataclasses.dataclass(frozen=True)
class Flash:
    """An episode that has just ended.

    Attributes:
        pose_w: (3,) where the car was.
        agent: whose it was.
        outcome: one of `OUTCOMES`.
        age: 0 when it ended, 1 when the flash is over.
    """

    pose_w: np.ndarray
    agent: int
    outcome: str
    age: float


@dataclasses.dataclass(frozen=True)
class Snapshot:
    """One instant.

    Attributes:
        seconds: since the start.
        pose_w: (agents, 3) footprint centres.
        steering: (agents,) bicycle angles [rad].
        goal_pose: (agents, 3) goal bays; NaN for agents that explore.
        goal_size: (agents, 2) sizes of goal bays [m]; NaN for agents that explore.
        parked_pose: (parked cars, 3) footprint centres.
        active: (agents,) bool, the agent's episode is running.
        state: a word or two per agent: what it does, or how its episode ended.
        tally: numbers to show by name: episodes ended so far, by outcome.
        flashes: episodes that ended a moment ago.
        kind: (agents,) which of the fleet's kinds of cars they drive; None if it has
            one.
        tracked_bay_xy: (agents, slots, 2) centres of tracked bays, NaN in empty slots;
            None while goals are fixed.
        movers: obstacles that move by themselves.
    """

    seconds: float
    pose_w: np.ndarray
    steering: np.ndarray
    goal_pose: np.ndarray
    goal_size: np.ndarray
    parked_pose: np.ndarray
    active: np.ndarray
    state: tuple[str, ...]
    tally: dict[str, float]
    flashes: tuple[Flash, ...]
    kind: np.ndarray | None = None
    tracked_bay_xy: np.ndarray | None = None
    movers: tuple[Group, ...] = ()


def num_frames(recording: Recording) -> int:
    """Poses recorded, one after every traced instant."""
    return recording.pose_w.shape[0] * recording.pose_w.shape[1]


def frames_per_second(recording: Recording) -> float:
    """Frame rate at which all frames of a recording play in real time."""
    return recording.pose_w.shape[1] / recording.ctrl_dt


def snapshot(recording: Recording, index: int) -> Snapshot:
    """The recorded instant `index`, from 0 to `num_frames(recording)` - 1."""
    traces = recording.pose_w.shape[1]
    step, trace = divmod(index, traces)
    goal_pose, goal_size = aimed_at(recording.layout, recording.goal[step])
    bay_xy, bays = None, recording.tracked_bays
    if bays is not None:
        pose, _ = aimed_at(recording.layout, bays[step].reshape(-1))
        bay_xy = pose[:, :2].reshape(*bays.shape[1:], 2)
    # What happens in a step is known when it is over.
    over = (index + 1) // traces
    ended = {name: getattr(recording, name) for name in OUTCOMES}
    seconds = (index + 1) / frames_per_second(recording)
    flashes = []
    for name, events in ended.items():
        for when, agent in np.argwhere(events[:over]):
            age = (seconds - (when + 1) * recording.ctrl_dt) / FLASH_SECONDS
            if age < 1.0:
                pose = recording.pose_w[when, -1, agent]
                flashes.append(Flash(pose, int(agent), name, float(max(age, 0.0))))
    return Snapshot(
        seconds=seconds,
        pose_w=recording.pose_w[step, trace],
        steering=recording.steering[step],
        goal_pose=goal_pose,
        goal_size=goal_size,
        parked_pose=recording.parked_pose[step, trace],
        active=recording.active[step],
        state=tuple(_state(recording, step, agent) for agent in range(len(goal_pose))),
        tally={name: int(events[:over].sum()) for name, events in ended.items()},
        flashes=tuple(flashes),
        kind=None if recording.kind is None else recording.kind[step],
        tracked_bay_xy=bay_xy,
        movers=tuple(take(group, step).instant(trace) for group in recording.movers),
    )


def aimed_at(layout: Layout, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses (agents, 3) and sizes (agents, 2) of goals (agents,); NaN of `NO_BAY`."""
    has_goal = (goal != NO_BAY)[:, None]
    bay = np.minimum(goal, layout.num_bays - 1)
    pose, size = np.asarray(layout.bay_pose)[bay], np.asarray(layout.bay_size)[bay]
    return np.where(has_goal, pose, np.nan), np.where(has_goal, size, np.nan)


def _state(recording: Recording, step: int, agent: int) -> str:
    if not recording.active[step, agent]:
        if recording.step[step, agent] == 1:  # this one, and none before it
            return "waits"
        for name in OUTCOMES:
            if getattr(recording, name)[:step, agent].any():
                return name.replace("_", " ")
        return "diverged"
    speed = recording.speed[step, agent]
    moving = "drives" if speed > 0 else "reverses"
    state = "stands" if abs(speed) < STANDING else moving
    exploring = recording.goal[step, agent] == NO_BAY
    return f"{state}, explores" if exploring else state


def tracked_points(snapshot: Snapshot, tracked: Tracked) -> list[tuple[int, Any]]:
    """(agent, point (2,)) for every car and every bay an agent tracks."""
    agents, parked = snapshot.pose_w[:, :2], snapshot.parked_pose[:, :2]
    others = ~np.eye(len(agents), dtype=bool)
    parked_mask = np.ones((len(agents), len(parked)), bool)
    both = np.concatenate([agents, parked]), np.concatenate([others, parked_mask], 1)
    pairs = []
    for points, mask, count in (
        (agents, others, tracked.agents),
        (parked, parked_mask, tracked.parked_cars),
        (*both, tracked.cars),
    ):
        if not count or not len(points):
            continue
        index, present = nearest(
            jnp.asarray(agents), jnp.asarray(points), jnp.asarray(mask), count
        )
        pairs += [
            (int(agent), points[int(index[agent, slot])])
            for agent, slot in np.argwhere(np.asarray(present))
        ]
    if snapshot.tracked_bay_xy is not None:
        pairs += [
            (agent, point)
            for agent, points in enumerate(snapshot.tracked_bay_xy)
            for point in points
            if not np.isnan(point).any()
        ]
    return pairs
