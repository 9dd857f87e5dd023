"""Records a policy in one lot, and what is visible at one instant of that."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.evaluator import CHUNK
from carpark_mj.evaluation.keys import evaluation_key
from carpark_mj.geometry import nearest, wrap_angle
from carpark_mj.geometry.obstacles import Group, take
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.fields import Tracked
from carpark_mj.policy.acting import AnyPolicy, Carry, Step, acts, as_argument, roll_out
from carpark_mj.rendering.stage import Flash, Snapshot, Stage
from carpark_mj.types import NO_BAY, OUTCOMES, Motion, ParkedCars, State


@dataclasses.dataclass(frozen=True)
class Recording:
    """A stretch of driving in one lot; `t` control steps, `k` poses in each.

    Absent agents and parked cars are left out.
    """

    layout: Layout
    ctrl_dt: float  # control period [s]
    # (t, k, agents, 3) footprint centres; the last of a step are before any respawn
    pose_w: np.ndarray
    steering: np.ndarray  # (t, agents) bicycle angles at the end of the steps [rad]
    speed: np.ndarray  # (t, agents) signed speeds at the end of the steps [m/s]
    goal: np.ndarray  # (t, agents) during the steps, `NO_BAY` of agents that explore
    parked_pose: np.ndarray  # (t, k, parked cars, 3) centres, see `parked_trace`
    active: np.ndarray  # (t, agents) bool
    parked: np.ndarray  # (t, agents) bool, the agent parked in this step
    crashed: np.ndarray  # the same of crashes
    timed_out: np.ndarray  # and of time-outs
    step: np.ndarray  # (t, agents) control steps made in the episode, this one included
    kind: np.ndarray | None = None  # (t, agents) kinds of a fleet; None if it has one
    parked_cars: ParkedCars | None = None  # as the lot began; None if all are alike
    # (t, agents, slots) bays tracked during the steps, `NO_BAY` in empty slots;
    # None while goals are fixed
    tracked_bays: np.ndarray | None = None
    movers: tuple[Group, ...] = ()  # (t, ...) in front


def recording_stage(env: ParkingEnv, recording: Recording) -> Stage:
    """The stage with the lot and the cars of a recording."""
    parked_cars = recording.parked_cars
    return Stage(
        recording.layout,
        env.vehicle,
        recording.pose_w.shape[2],
        recording.parked_pose.shape[2],
        env.fleet.agents,
        () if parked_cars is None else env.fleet.parked_vehicles(parked_cars),
        take(recording.movers, 0),
    )


def parked_trace(before: State, after: State, motion: Motion) -> jax.Array:
    """Poses (k, num_parked_cars, 3) of parked cars at the k traced instants of a step.

    Physics has pushed cars at its end; until then they are on a straight line.
    A car that is relocated at the end stays where it was.
    """
    start, end = before.parked_cars, after.parked_cars
    push = end.pose_w - start.pose_w
    push = push.at[:, 2].set(wrap_angle(push[:, 2]))
    push = jnp.where((end.bay == start.bay)[:, None], push, 0.0)
    num_traces = motion.trace_w.shape[-2]
    share = jnp.arange(1, num_traces + 1) / num_traces
    return start.pose_w + share[:, None, None] * push


def record(env: ParkingEnv, policy: AnyPolicy, num_steps: int, seed: int) -> Recording:
    """Drives one held-out lot for `num_steps` control steps."""
    reset_key, act_key = jax.random.split(evaluation_key(seed))
    state, observation = jax.jit(lambda key: env.reset(key, "test"))(reset_key)

    def report(step: Step) -> dict[str, Any]:
        before, timestep = step.before, step.timestep
        motion, events = timestep.motion, timestep.events
        frame = {
            "pose_w": motion.trace_w.swapaxes(0, 1),
            "steering": motion.steering,
            "speed": motion.speed,
            "goal": timestep.goal,
            "parked_pose": parked_trace(before, step.after, motion),
            "active": before.active,
            "parked": events.parked,
            "crashed": events.crashed,
            "timed_out": events.timed_out,
            "step": before.step + 1,
            "movers": step.after.movers.groups,
        }
        fleet = {"kind": before.kind, "tracked_bays": before.tracked_bays}
        return frame | {name: x for name, x in fleet.items() if x is not None}

    run = jax.jit(
        lambda policy, carry, keys: roll_out(env, acts(policy), carry, keys, report)
    )
    policy, carry, chunks = as_argument(policy), Carry(state, observation), []
    num_chunks = -(-num_steps // CHUNK)
    for keys in jax.random.split(act_key, num_chunks * CHUNK).reshape(num_chunks, -1):
        carry, frames = run(policy, carry, keys)
        chunks.append(jax.device_get(frames))
    frames = jax.tree.map(lambda *xs: np.concatenate(xs)[:num_steps], *chunks)
    movers = frames.pop("movers")
    # A lot keeps its parked cars and agents, except waiting ones: others never come.
    here, mine = np.asarray(state.parked_cars.present), np.flatnonzero(state.takes_part)
    own = {"pose_w": np.s_[:, :, mine], "parked_pose": np.s_[:, :, here]}
    frames = {n: x[own.get(n, np.s_[:, mine])] for n, x in frames.items()}
    return Recording(
        layout=state.layout,
        ctrl_dt=env.config.sim.ctrl_dt,
        parked_cars=jax.tree.map(lambda x: x[here], jax.device_get(state.parked_cars)),
        movers=movers,
        **frames,
    )


FLASH_SECONDS = 0.8  # how long an ended episode flashes
STANDING = 0.1  # m/s, slower cars stand


def snapshot_of(state: State) -> Snapshot:
    """A lot as `ParkingEnv.reset` or `step` leaves it."""
    goal_pose, goal_size = aimed_at(state.layout, np.asarray(state.goal))
    return Snapshot(
        pose_w=np.asarray(state.motion.pose_w),
        steering=np.asarray(state.motion.steering),
        goal_pose=goal_pose,
        goal_size=goal_size,
        parked_pose=np.asarray(state.parked_cars.pose_w),
        active=np.asarray(state.active),
        kind=None if state.kind is None else np.asarray(state.kind),
        movers=state.movers.groups,
    )


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
    bay_xy = None
    if recording.tracked_bays is not None:
        bay_xy = aimed_at(recording.layout, recording.tracked_bays[step])[0][..., :2]
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
    """Poses (..., 3) and sizes (..., 2) of goals (...); NaN of `NO_BAY`."""
    has_goal = (goal != NO_BAY)[..., None]
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
    state = "drives" if speed > 0 else "reverses"
    state = "stands" if abs(speed) < STANDING else state
    return state + ", explores" * bool(recording.goal[step, agent] == NO_BAY)


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
        where = np.argwhere(np.asarray(present)).tolist()
        pairs += [(agent, points[int(index[agent, slot])]) for agent, slot in where]
    if (bays := snapshot.tracked_bay_xy) is not None:
        where = np.argwhere(~np.isnan(bays).any(axis=-1)).tolist()
        pairs += [(agent, bays[agent, slot]) for agent, slot in where]
    return pairs
