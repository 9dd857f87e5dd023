"""The suite of hard cases: one car parks in every case of some levels.

All policies drive the same car, `tpcap`, on the same physics, without noise. The cases
are in the package (`suite.levels`); an episode ends after 100 s. Another car may drive
through the aisle meanwhile, see `moving_car`; it is not judged.
"""

import dataclasses
import functools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    FleetConfig,
    JitterConfig,
    MetricsConfig,
    RandomizationConfig,
    SensorConfig,
    SpawnConfig,
)
from carpark_mj.config.obstacles import make_movers
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import (
    Row,
    complete_row,
    summarize,
    wilson_interval,
)
from carpark_mj.evaluation.evaluator import CHUNK
from carpark_mj.evaluation.keys import evaluation_key
from carpark_mj.layouts import Layout
from carpark_mj.mdp.people import CLOSE_TIME
from carpark_mj.observations import observe
from carpark_mj.obstacles import place_movers, trace_still
from carpark_mj.policy.acting import (
    AnyPolicy,
    Carry,
    Step,
    as_argument,
    choose_actions,
    roll_out,
)
from carpark_mj.suite import moving_car
from carpark_mj.suite.hope import HopeConfig
from carpark_mj.suite.levels import Cases, CaseStart, in_order
from carpark_mj.types import State

VEHICLE = "tpcap"
SECONDS = 100.0  # of an episode: HOPE's 200 actions of 0.5 s
MOVING_CAR = "moving_car"  # column of episodes with one
MOVING = ("person", "mover")  # what cars of a level with movers may hit
HITS_OF_MOVING = tuple(f"hit_{kind}" for kind in MOVING)
AMONG = {  # columns of such levels, and what they are means of
    "hit person": "hit_person",
    "hit mover": "hit_mover",
    "near miss": "near_miss",
    "least gap [m]": "least_gap",
}
TIMED = 20  # calls of a policy whose shortest counts


def suite_env(env: EnvConfig, rule: str, with_moving_car: bool = False) -> EnvConfig:
    """The environment of a policy with the suite's lots, car and rules.

    Args:
        env: of its training.
        rule: when the car counts as parked.
        with_moving_car: add a second agent, the moving car.

    Raises:
        ValueError: the policy does not steer a car, or it chooses its goals and a
            moving car is requested.
    """
    if not env.physics_config.steers:
        raise ValueError(
            "the suite's cases need a policy that steers a car, not one of "
            f"{env.physics_config.back_end} physics"
        )
    if with_moving_car and env.goals.dynamic:
        raise ValueError(
            "a moving car needs policies with fixed goals, goals.dynamic = False"
        )
    alone = {"num_agents": 1, "min_agents": None, "occupancy": None}
    # An occupancy turns off the check that every agent has a bay in every lot: that of
    # the moving car is added to the held-out lots.
    moving = {"num_agents": 2, "min_agents": 1, "occupancy": (0.0, 0.0)}
    agents: dict[str, Any] = moving if with_moving_car else alone
    return dataclasses.replace(
        env,
        layout=HopeConfig("extreme", "parallel"),
        vehicle=VEHICLE,
        num_parked_cars=0,
        **agents,
        fleet=FleetConfig(),
        jitter=JitterConfig(),
        randomization=RandomizationConfig(),
        sensors=SensorConfig(),
        spawn=SpawnConfig(close_ratio=0.0),
        episode=EpisodeConfig(
            parked_rule=rule,
            max_steps=round(SECONDS / env.sim.ctrl_dt),
            respawn=False,
        ),
        metrics=MetricsConfig(),
    )


class Drives(NamedTuple):
    """Driven paths of n cases, t control steps with k poses in each.

    Values after the last step of an episode are meaningless. The first of the a agents
    parks.

    Attributes:
        pose_w: (n, t, a, k, 3) footprint centres.
        steering: (n, t, a) bicycle angles at the end of the steps [rad].
        speed: (n, t, a) signed speeds at the end of the steps [m/s].
    """

    pose_w: np.ndarray
    steering: np.ndarray
    speed: np.ndarray


class CaseEvaluator:
    """Drives cases; a policy's programs compile once per shape of the cases.

    Equal numbers of cases of HOPE's levels have the same shape.
    """

    def __init__(self, env: ParkingEnv) -> None:
        """Takes the environment, one of `suite_env`."""
        self.env = env
        self._reset = jax.jit(jax.vmap(_reset(env)))
        self._chunk = jax.jit(functools.partial(_chunk, env))
        self._choose_action = jax.jit(_choose_action)

    def drive(
        self, policy: AnyPolicy, cases: Cases, seed: int
    ) -> tuple[list[Row], Drives]:
        """One episode in each case, side by side.

        Args:
            policy: acting function; a planner must have been reset.
            cases: to drive, with a moving car if the environment has one.
            seed: of the policy's random numbers.

        Returns:
            A row for each, see `evaluation.catalogue`, and the driven paths.
        """
        count, moving = len(cases.number), self.env.num_agents > 1
        ctrl_dt = self.env.config.sim.ctrl_dt
        reset_key, act_key = jax.random.split(evaluation_key(seed))
        keys = jax.random.split(reset_key, count)
        state, observation = self._reset(cases.layouts, keys, cases.start)
        progress = moving_car.init_progress(count) if moving else None
        rows: list[Row | None] = [None] * count
        chunks: list[tuple[np.ndarray, ...]] = []
        policy, carry = as_argument(policy), Carry(state, observation, progress)
        while any(row is None for row in rows):
            act_key, own = jax.random.split(act_key)
            carry, out = self._chunk(policy, carry, jax.random.split(own, CHUNK))
            done, metrics, recorded = out
            chunks.append(jax.device_get(recorded))
            metrics = {name: np.asarray(value) for name, value in metrics.items()}
            for t, lot in np.argwhere(np.asarray(done)[..., 0]):
                if rows[lot] is None:
                    row = {n: float(value[t, lot, 0]) for n, value in metrics.items()}
                    rows[lot] = _label(cases, lot) | complete_row(row, ctrl_dt)
        drives = Drives(
            *(
                np.concatenate(parts).swapaxes(0, 1)
                for parts in zip(*chunks, strict=True)
            )
        )
        finished = [row for row in rows if row is not None]
        if self.env.config.movers:
            finished = list(map(_add_moving, finished, drives.speed[..., 0]))
        return finished, drives

    def decision_time(self, policy: AnyPolicy, cases: Cases) -> float:
        """Time of a policy for one decision of one car [s]."""
        key = jax.random.key(0)
        keys = jax.random.split(key, len(cases.number))
        starts = self._reset(cases.layouts, keys, cases.start)
        state, observation = jax.tree.map(lambda x: x[0], starts)
        policy, taken = as_argument(policy), []
        for _ in range(TIMED + 1):
            begun = time.perf_counter()
            self._choose_action(policy, state, observation, key).block_until_ready()
            taken.append(time.perf_counter() - begun)
        return min(taken[1:])


def _reset(env: ParkingEnv) -> Callable[[Layout, jax.Array, CaseStart | None], Any]:
    plain = env.reset_to_layout
    if env.num_agents > 1:
        plain = functools.partial(moving_car.reset, env)

    def begin(layout: Layout, key: jax.Array, start: CaseStart | None) -> Any:
        if start is None:
            return plain(layout, key)
        state, _ = env.reset_to_layout(layout, start.key, None, start.options)
        movers = place_movers(make_movers(env.config.movers), start.movers)
        movers = trace_still(movers, env.config.sim.num_traces)
        state = dataclasses.replace(state, movers=movers)
        return state, observe(env.config, state)

    return begin


def _add_moving(row: Row, speed: np.ndarray) -> Row:
    """A row with what happened to people and movers; of a car's speeds (t,) [m/s]."""
    last = round(row["length"])
    hit = any(row.get(name) for name in HITS_OF_MOVING)
    own = {f"min_clearance_{kind}": math.inf for kind in MOVING} | row
    soon = min(row.get(f"min_collision_time_{kind}", math.inf) for kind in MOVING)
    near = soon < CLOSE_TIME or row.get("near_misses", 0.0) > 0
    return row | {
        "contact_speed": float(np.abs(speed[max(last - 2, 0) : last]).max() * hit),
        "least_gap": min(own[f"min_clearance_{kind}"] for kind in MOVING),
        "near_miss": float(near and not hit),
    }


def _chunk(env: ParkingEnv, policy: AnyPolicy, carry: Carry, keys: jax.Array) -> Any:
    """Makes a control step for every key; returns a report of each."""
    drive_on = functools.partial(moving_car.drive, ctrl_dt=env.config.sim.ctrl_dt)

    def act(state: State, observation: jax.Array, memory: Any, key: jax.Array) -> Any:
        action = _choose_action(policy, state, observation, key)
        if memory is not None:  # of the moving car
            other, memory = jax.vmap(drive_on)(state, memory)
            action = jnp.concatenate([action, other[:, None]], axis=1)
        return action, memory

    def report(step: Step) -> Any:
        timestep, motion = step.timestep, step.timestep.motion
        recorded = (motion.trace_w, motion.steering, motion.speed)
        return timestep.events.done, timestep.metrics, recorded

    return roll_out(env, act, carry, keys, report)


def _choose_action(
    policy: AnyPolicy, state: State, observation: jax.Array, key: jax.Array
) -> jax.Array:
    """Actions (..., 1, size) of the agents that park; a policy drives only these."""
    own = jnp.arange(state.active.shape[-1]) == 0
    state = dataclasses.replace(state, active=state.active & own)
    action = choose_actions(policy, state, observation[..., :1, :], key)
    return action[..., :1, :]


def _label(cases: Cases, lot: int) -> Row:
    return {
        "level": cases.level,
        "case": int(cases.number[lot]),
        "kind": str(cases.kind[lot]),
    }


def worst_first(rows: Sequence[Row]) -> list[Row]:
    """Episodes in order: crashes, then timeouts, then the slowest."""
    return sorted(
        rows, key=lambda row: (-row["crashed"], row["parked"], -row["length"])
    )


def has_moving_car(rows: Sequence[Row]) -> bool:
    """Whether a car moved through the aisle in these episodes, as in all or in none."""
    return any(row.get(MOVING_CAR) for row in rows)


def planned_paths(rows: Sequence[Row]) -> dict[tuple[int, str, int], float]:
    """Length of the planner's paths [m] by seed, level and case, where it found one."""
    return {
        (row["seed"], row["level"], row["case"]): row["planned_path"]
        for row in rows
        if not math.isnan(row.get("planned_path", math.nan))
    }


def table_rows(policy: str, rows: Sequence[Row]) -> list[dict[str, Any]]:
    """A row of results for every level and kind of a policy.

    Args:
        policy: its name.
        rows: all episodes of the suite, of `CaseEvaluator`, with the names of their
            policies and their seeds. Those of the planner also have `planned`, whether
            it found a path, `planned_path`, its length [m], and `planning_seconds`.
    """
    plans = planned_paths(rows)
    own = [row for row in rows if row["policy"] == policy]
    found = []
    for level in in_order(row["level"] for row in own):
        of_level = [row for row in own if row["level"] == level]
        kinds = sorted({row["kind"] for row in of_level})
        for kind in (*kinds, "all") if len(kinds) > 1 else kinds:
            part = [row for row in of_level if kind in ("all", row["kind"])]
            which = {"policy": policy, "level": level, "kind": kind}
            found.append(which | _sum(part, plans))
    return found


def _sum(rows: list[Row], plans: dict[tuple[int, str, int], float]) -> dict[str, Any]:
    summary, seeds = summarize(rows), sorted({row["seed"] for row in rows})
    cases = len({row["case"] for row in rows})
    ratios = []
    for row in rows:
        planned = plans.get((row["seed"], row["level"], row["case"]), 0.0)
        if row["parked"] and planned > 0:
            ratios.append(row["path"] / planned)
    rate = summary["parked"]["rate"]
    # The same case with another seed is not another case.
    low, high = wilson_interval(rate * cases, cases)
    decision = _mean(rows, "ms / decision")
    moving = has_moving_car(rows)
    among = [row for row in rows if "least_gap" in row]
    speeds = [row["contact_speed"] for row in among if row["contact_speed"] > 0]
    return {
        "cases": cases,
        "seeds": len(seeds),
        "parked": rate,
        "low": low,
        "high": high,
        "by seed": [
            _mean([row for row in rows if row["seed"] == seed], "parked")
            for seed in seeds
        ],
        "crashed": summary["crashed"]["rate"],
        **({"hit moving car": summary["hit_agent"]["rate"]} if moving else {}),
        **({name: _mean(among, key) for name, key in AMONG.items()} if among else {}),
        **({"fastest contact [m/s]": max(speeds, default=math.nan)} if among else {}),
        "timed out": summary["timed_out"]["rate"],
        "path found": _mean(rows, "planned"),
        "gear changes": summary["gear_changes"],
        "path [m]": summary["path"],
        "path / planned": float(np.mean(ratios)) if ratios else math.nan,
        "off by [m]": summary["final_distance"],
        "off by [deg]": math.degrees(summary["final_heading"]),
        "time [s]": summary["time_to_park"],
        "planning [s]": _mean(rows, "planning_seconds"),
        "ms / decision": decision,
        "decisions/s": 1e3 / decision,
    }


def _mean(rows: Sequence[Row], name: str) -> float:
    values = [row[name] for row in rows if name in row]
    return float(np.mean(values)) if values else math.nan
