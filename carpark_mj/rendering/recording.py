"""Records a policy in one lot, for the renderer."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.evaluator import CHUNK
from carpark_mj.evaluation.keys import evaluation_key
from carpark_mj.geometry import wrap_angle
from carpark_mj.geometry.obstacles import Group, take
from carpark_mj.layouts.types import Layout
from carpark_mj.policy.acting import AnyPolicy, Carry, Step, acts, as_argument, roll_out
from carpark_mj.rendering.stage import Stage
from carpark_mj.types import Motion, ParkedCars, State


@dataclasses.dataclass(frozen=True)
class Recording:
    """A stretch of driving in one lot; `t` control steps, `k` poses in each.

    Absent agents and parked cars are left out.

    Attributes:
        layout: the lot.
        ctrl_dt: control period [s].
        pose_w: (t, k, agents, 3) footprint centres; the last of each step is the
            pose at its end, before any respawn.
        steering: (t, agents) bicycle angles at the end of the steps [rad].
        speed: (t, agents) signed speeds at the end of the steps [m/s].
        goal: (t, agents) goals during the steps, `NO_BAY` of agents that explore.
        parked_pose: (t, k, parked cars, 3) centres of the parked cars, see
            `parked_trace`.
        active: (t, agents) bool.
        parked: (t, agents) bool, the agent parked in this step.
        crashed: (t, agents) bool, the agent crashed in this step.
        timed_out: (t, agents) bool, the agent timed out in this step.
        step: (t, agents) control steps made in the episode, this one included.
        kind: (t, agents) which of the fleet's kinds of cars they drive; None if it has
            one.
        parked_cars: (parked cars,) as the lot began; None if all are alike.
        tracked_bays: (t, agents, slots) bays tracked during the steps, `NO_BAY` in
            empty slots; None while goals are fixed.
        movers: obstacles that move by themselves, (t, ...) in front.
    """

    layout: Layout
    ctrl_dt: float
    pose_w: np.ndarray
    steering: np.ndarray
    speed: np.ndarray
    goal: np.ndarray
    parked_pose: np.ndarray
    active: np.ndarray
    parked: np.ndarray
    crashed: np.ndarray
    timed_out: np.ndarray
    step: np.ndarray
    kind: np.ndarray | None = None
    parked_cars: ParkedCars | None = None
    tracked_bays: np.ndarray | None = None
    movers: tuple[Group, ...] = ()


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

    Physics tells where pushed cars are at its end; until then they are on a straight
    line. A car that is relocated at the end stays where it was.

    Args:
        before: the step.
        after: it.
        motion: of the agents in it.
    """
    start, end = before.parked_cars, after.parked_cars
    push = end.pose_w - start.pose_w
    push = push.at[:, 2].set(wrap_angle(push[:, 2]))
    push = jnp.where((end.bay == start.bay)[:, None], push, 0.0)
    num_traces = motion.trace_w.shape[-2]
    share = jnp.arange(1, num_traces + 1) / num_traces
    return start.pose_w + share[:, None, None] * push


def record(env: ParkingEnv, policy: AnyPolicy, num_steps: int, seed: int) -> Recording:
    """Drives one held-out lot for `num_steps` control steps.

    `CHUNK` steps make one program, whatever their number: it is compiled once.
    """
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
        if before.kind is not None:
            frame["kind"] = before.kind
        if before.tracked_bays is not None:
            frame["tracked_bays"] = before.tracked_bays
        return frame

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
    # A lot keeps its parked cars: who is absent at the start never comes.
    here = np.asarray(state.parked_cars.present)
    frames["parked_pose"] = frames["parked_pose"][:, :, here]
    # The same of the agents, but for those that wait.
    mine = np.flatnonzero(state.takes_part)
    own = {"pose_w": np.s_[:, :, mine], "parked_pose": np.s_[:]}
    frames = {n: x[own.get(n, np.s_[:, mine])] for n, x in frames.items()}
    return Recording(
        layout=state.layout,
        ctrl_dt=env.config.sim.ctrl_dt,
        parked_cars=jax.tree.map(lambda x: x[here], jax.device_get(state.parked_cars)),
        movers=movers,
        **frames,
    )
