"""The suite of hard cases, `carpark_mj suite`: one car parks in every case of levels.

All policies drive the same car, `tpcap` by default, on the same ground, without noise;
it brakes by itself as in a policy's training. An episode ends after 100 s.
"""

import dataclasses
import functools
import itertools
import math
from pathlib import Path
from typing import Any

import jax
import numpy as np

from carpark_mj.benchmarking import best_time
from carpark_mj.cli.clock import COMPILING, doing
from carpark_mj.cli.driver import find_driver
from carpark_mj.cli.settings.tables import WORST, SuiteConfig
from carpark_mj.config import EnvConfig, EpisodeConfig, SpawnConfig, find_rules
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import Row, complete_row
from carpark_mj.evaluation.evaluator import ended_episodes
from carpark_mj.evaluation.keys import evaluation_key
from carpark_mj.files import require_writable
from carpark_mj.layouts import Layout
from carpark_mj.mdp.parked_cars import in_bays
from carpark_mj.mdp.people import CLOSE_TIME
from carpark_mj.observations import ContinuousObservation, observe
from carpark_mj.obstacles import make_movers, place_movers, trace_still
from carpark_mj.planning.policy import Planner, planner_policy
from carpark_mj.policy.acting import (
    AnyPolicy,
    Carry,
    Step,
    acts,
    as_argument,
    choose_actions,
    roll_out,
)
from carpark_mj.policy.named import RECORDED, find_named
from carpark_mj.spawning.reset_options import check_starts
from carpark_mj.suite.hope import HopeConfig
from carpark_mj.suite.levels import Cases, CaseStart, find_level, require_filmed
from carpark_mj.suite.page import write_report
from carpark_mj.suite.report import PLANNER, made_with, require_gl, worst_first
from carpark_mj.suite.results import CAR, VEHICLE, Drives, Key, Scene, key_of, read_runs
from carpark_mj.types import State
from carpark_mj.vehicle import preset

SECONDS = 100.0  # of an episode: HOPE's 200 actions of 0.5 s
MOVING = ("person", "mover")  # what cars of a level with movers may hit
# Settings of a policy's training that cases do without.
PLAIN = "movers", "fleet", "jitter", "randomization", "sensors", "metrics"
BLIND = (PLANNER, "zero", "random")  # policies that use no observation
TIMED = 20  # calls of a policy whose shortest counts


def suite_env(env: EnvConfig, rule: str, vehicle: str = VEHICLE) -> EnvConfig:
    """The environment of a policy's training with the suite's lots, car and rules.

    `rule` says when the car counts as parked; `vehicle` is a preset or file.
    """
    if not env.physics_config.steers:
        raise ValueError(
            "the suite's cases need a policy that steers a car, not one of "
            f"{env.physics_config.back_end} physics"
        )
    steps = round(SECONDS / env.sim.ctrl_dt)
    return dataclasses.replace(
        env,
        layout=HopeConfig("extreme", "parallel"),
        vehicle=vehicle,
        num_agents=1,
        min_agents=None,
        num_parked_cars=0,
        occupancy=None,
        **{name: getattr(EnvConfig(), name) for name in PLAIN},
        spawn=SpawnConfig(close_ratio=0.0),
        episode=EpisodeConfig(parked_rule=rule, max_steps=steps, respawn=False),
    )


def policy_env(name: str, env: EnvConfig, config: SuiteConfig) -> EnvConfig:
    """The environment in which a policy by name drives, before that of a level.

    Levels with several cars need an environment in which cars observe their own. For
    policies of `BLIND` it makes no other difference.
    """
    if name in BLIND or name.startswith(RECORDED):
        env = dataclasses.replace(env, observation=ContinuousObservation(own_car=True))
    return suite_env(env, config.rule, config.vehicle)


class CaseEvaluator:
    """Drives cases; a policy's programs compile once per shape of the cases.

    Equal numbers of cases of HOPE's levels have the same shape.
    """

    def __init__(self, env: ParkingEnv, filmed: bool = False) -> None:
        """Takes one of `suite_env`, and whether films are made."""
        self.env, self._filmed = env, filmed
        self._reset = jax.jit(jax.vmap(functools.partial(_reset, env)))
        self._chunk = jax.jit(functools.partial(_chunk, env, filmed=filmed))
        self._choose_actions = jax.jit(choose_actions)

    def drive(
        self, policy: AnyPolicy, cases: Cases, seed: int
    ) -> tuple[list[Row], Drives]:
        """One episode in each case, side by side; `seed` is the policy's.

        A planner must have been reset. Returns a row for each case, see
        `evaluation.catalogue`, and the driven paths.
        """
        count = len(cases.number)
        reset_key, act_key = jax.random.split(evaluation_key(seed))
        keys = jax.random.split(reset_key, count)
        state, observation = self._reset(cases.layouts, keys, cases.start)
        if cases.start is not None and cases.start.parked is not None:
            # A user's scenario, whose start may be impossible.
            try:
                check_starts(self.env.config, cases.start.options, state)
            except ValueError as error:
                raise ValueError(f"an impossible start, {error}") from None
        carry = Carry(state, observation)
        policy, chunks = as_argument(policy), list[Any]()

        def chunk(carry: Carry, keys: jax.Array) -> Any:
            carry, (done, metrics, recorded) = self._chunk(policy, carry, keys)
            chunks.append(jax.device_get(recorded))
            return carry, (done, metrics)

        ended = ended_episodes(chunk, carry, act_key, np.ones((count, 1), int))
        dt = self.env.config.sim.ctrl_dt
        values = {int(which["lot"]): complete_row(row, dt) for which, row in ended}
        pose_w, steering, speed, movers = jax.tree.map(
            lambda *parts: np.concatenate(parts).swapaxes(0, 1), *chunks
        )
        scene = None
        if self._filmed:
            goal, parked = jax.device_get((state.goal[:, 0], state.parked_cars))
            scene = Scene(goal, parked, movers)
        drives = Drives(pose_w, steering, speed, scene)
        which = zip(cases.number.tolist(), cases.kind.tolist(), strict=True)
        rows = [
            {"level": cases.level, "case": number, "kind": kind, **values[lot]}
            for lot, (number, kind) in enumerate(which)
        ]
        if self.env.config.movers:
            rows = list(map(_add_moving, rows, drives.speed[..., 0]))
        return rows, drives

    def decision_time(self, policy: AnyPolicy, cases: Cases) -> float:
        """Time of a policy for one decision of one car [s]."""
        key = jax.random.key(0)
        keys = jax.random.split(key, len(cases.number))
        starts = self._reset(cases.layouts, keys, cases.start)
        state, observation = jax.tree.map(lambda x: x[0], starts)
        policy = as_argument(policy)

        def decide() -> jax.Array:
            return self._choose_actions(policy, state, observation, key)

        jax.block_until_ready(decide())
        return best_time(decide, TIMED)


def _reset(
    env: ParkingEnv, layout: Layout, key: jax.Array, start: CaseStart | None
) -> tuple[State, jax.Array]:
    if start is None:
        return env.reset_to_layout(layout, key)
    state, _ = env.reset_to_layout(layout, start.key, None, start.options)
    if start.parked is not None:
        cars = in_bays(layout, state.parked_cars, start.parked)
        state = dataclasses.replace(state, parked_cars=cars)
    movers = place_movers(make_movers(env.config.movers), start.movers)
    movers = trace_still(movers, env.config.sim.num_traces)
    state = dataclasses.replace(state, movers=movers)
    return state, observe(env.config, state)


def _add_moving(row: Row, speed: np.ndarray) -> Row:
    """A row with what happened to people and movers; of a car's speeds (t,) [m/s]."""
    last = round(row["length"])
    hit = any(row.get(f"hit_{kind}") for kind in MOVING)
    gap, soon = (
        min(row.get(f"min_{what}_{kind}", math.inf) for kind in MOVING)
        for what in ("clearance", "collision_time")
    )
    near = soon < CLOSE_TIME or row.get("near_misses", 0.0) > 0
    return row | {
        "contact_speed": float(np.abs(speed[max(last - 2, 0) : last]).max() * hit),
        "least_gap": gap,
        "near_miss": float(near and not hit),
    }


def _chunk(
    env: ParkingEnv, policy: AnyPolicy, carry: Carry, keys: jax.Array, filmed: bool
) -> Any:
    """Makes a control step for every key; returns a report of each."""

    def report(step: Step) -> Any:
        timestep, motion = step.timestep, step.timestep.motion
        movers = step.after.movers.groups if filmed else ()
        recorded = motion.trace_w, motion.steering, motion.speed, movers
        return timestep.events.done, timestep.metrics, recorded

    return roll_out(env, acts(policy), carry, keys, report)


def require_cases(config: SuiteConfig) -> None:
    """Refuses rules, cars, levels and first cases that there are not."""
    find_rules(config.rule)
    preset(config.vehicle)
    for level in config.levels:
        known = len(find_level(level).numbers)
        if config.first_case >= known:
            raise ValueError(
                f"first_case must be 0 to {known - 1}, not {config.first_case}: level "
                f"{level} has {known} cases"
            )


def main(config: SuiteConfig) -> list[dict[str, Any]]:
    """Drives, writes the files and prints the table; returns the table's rows."""
    require_cases(config)
    folder = Path(config.out)
    if folder.resolve() in [Path(name).resolve() for name in config.combine]:
        raise ValueError(f"out must not be one of the combined folders, {config.out}")
    if config.videos:
        require_gl()
    require_writable(folder / "suite.csv", new_folders=True)  # refused before the work
    if config.combine:
        episodes, drives = read_runs([Path(name) for name in config.combine])
        for level in {row["level"] for row in episodes} if config.videos else ():
            require_filmed(level)
    else:
        episodes, drives = _drive_all(config)
    return write_report(folder, episodes, drives, config.videos)


def _drive_all(config: SuiteConfig) -> tuple[list[Row], dict[Key, Drives]]:
    """Episodes, and the driven paths of the worst ones."""

    @functools.cache
    def evaluator_of(env: EnvConfig) -> CaseEvaluator:
        return CaseEvaluator(ParkingEnv(env), bool(config.videos))

    tasks: dict[str, list[tuple[CaseEvaluator, AnyPolicy, Planner | None]]] = {}
    # All are refused before one of them drives.
    for name in config.policies:
        driver = find_driver(name, config.environment if find_named(name) else "")
        base = policy_env(name, driver.env, config)
        evaluators = [evaluator_of(find_level(x).env(base)) for x in config.levels]
        pairs: dict[CaseEvaluator, tuple[AnyPolicy, Planner | None]] = {
            each: planner_policy(each.env)
            if name == PLANNER
            else (driver.policy(each.env), None)
            for each in dict.fromkeys(evaluators)  # equal for levels that are alike
        }
        tasks[name] = [(each, *pairs[each]) for each in evaluators]
    doing(COMPILING)
    first = config.first_case
    part = slice(first, first + config.cases if config.cases else None)
    cases = [find_level(level).pick(part) for level in config.levels]
    episodes: list[Row] = []
    drives: dict[Key, Drives] = {}
    for name, seed in itertools.product(config.policies, config.seeds):
        for part, task in zip(cases, tasks[name], strict=True):
            evaluator, policy, planner = task
            if planner is not None:
                planner.reset(seed, first)
            rows, driven = evaluator.drive(policy, part, seed)
            if planner is None:
                seconds = evaluator.decision_time(policy, part)
            else:
                rows = [row | _plan(planner, lot) for lot, row in enumerate(rows)]
                seconds = planner.seconds / planner.decisions
            level = find_level(part.level)
            vehicle = level.vehicle or config.vehicle
            which = {"policy": name, "seed": seed, "rule": level.rule or config.rule}
            which |= {"held_out": level.fingerprint}
            which |= {CAR: vehicle} if vehicle != VEHICLE else {}
            own = {"ms / decision": 1e3 * seconds, "made_with": made_with()}
            rows = [which | row | own for row in rows]
            episodes += rows
            for row in worst_first(rows)[:WORST]:
                number, length = rows.index(row), round(row["length"])
                drives[key_of(row)] = driven.of(number, length)
    return episodes, drives


def _plan(planner: Planner, lot: int) -> Row:
    """Results of the planner's first search in a lot."""
    path, seconds, _ = planner.searches(lot, 0)[0]
    return {
        "planned": float(path is not None),
        "planned_path": path.length if path else math.nan,
        "planning_seconds": seconds,
    }
