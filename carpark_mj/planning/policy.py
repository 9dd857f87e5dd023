"""The planner as a policy, `--policy planner`: agents drive on planned paths.

They know the true state of the lot: parked cars, walls and discs when they plan, the
positions of other agents and of movers while they drive. An agent slows down for movers
that are on its path or soon will be, stops for whatever is close, and plans again when
it is stuck. The host decides, in NumPy.
"""

import math
import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import io_callback

from carpark_mj.env import ParkingEnv
from carpark_mj.extensions import require_packages
from carpark_mj.geometry.obstacles import Boxes, Group, by_shape
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.planning.paths import (
    CREEP,
    CRUISE,
    FASTEST,
    STANDING,
    Command,
    Driven,
    PlannedPath,
    Progress,
    brake,
    hurry,
    rear_axle,
    track,
)
from carpark_mj.planning.search import FreeSpace, Search, SearchConfig, Solids, search
from carpark_mj.policy.acting import StatePolicy
from carpark_mj.policy.named import POLICIES
from carpark_mj.types import State
from carpark_mj.vehicle import VehicleParameters

LOOK_AHEAD = 2.5  # m of the path that must be free, more than cars need to stop
FORESEEN = (0.0, 0.4, 0.8, 1.2, 1.6, 2.0)  # s, when movers must not be there
PACES = (CRUISE, 0.6, CREEP)  # m/s among movers; less must be free of them when slow
ROOM = 1.25  # m before movers that stand, to drive around them
PASSING = 0.2  # m kept from movers by a path that leads around them
GAP = 0.3  # m kept from them
PATIENCE = 20  # control steps until an agent that stands plans again
PATIENCE_MOVERS = 40  # the same where there are movers, which often go away
ASTRAY = 0.3  # m from the path: the agent replans
MAX_PLANS = 6  # of an episode
IN_TIME = 0.9  # of the time left: a path that takes longer is driven faster


_NONE = np.zeros((0, 3))


class Sight(NamedTuple):
    """An agent and what surrounds it in a control step."""

    begins: bool  # whether its episode has just begun
    pose: np.ndarray  # (3,) of the footprint's centre
    speed: float  # signed [m/s]
    steering: float  # [rad]
    goal: np.ndarray  # the bay's middle, see `search`
    car: VehicleParameters  # parameters of its car
    solids: Solids  # obstacles at rest
    # (k, 3) poses and (k, 2) sizes of the other agents
    others: tuple[np.ndarray, np.ndarray]
    extent: np.ndarray  # (2,) of the lot [m]
    # (m, 3) poses, (m, 2) sizes and (m, 2) velocities of movers
    movers: tuple[np.ndarray, np.ndarray, np.ndarray] = (
        _NONE,
        _NONE[:, 1:],
        _NONE[:, 1:],
    )


class Agent:
    """One agent's path, how far it is on it, and its `searches` of this episode."""

    def __init__(
        self,
        seed: Sequence[int],
        dt: float,
        config: SearchConfig,
        seconds: float = math.inf,
    ) -> None:
        """An agent without a path, with a control period and episodes of `seconds`."""
        self.searches: list[Search] = []
        self._seconds = self._left = seconds
        self._seed, self._dt, self._config = tuple(seed), dt, config
        self._path: PlannedPath | None = None
        self._progress = Progress()
        self._stuck = 0

    def act(self, sight: Sight) -> tuple[float, float]:
        """Steer and pedal in [-1, 1]."""
        self._left -= self._dt
        if sight.begins:
            self.searches, self._left = [], self._seconds
            self._plan(sight, sight.solids)
        command = self._follow(sight)
        if command is not None and command.error > ASTRAY:
            self._plan(sight, sight.solids)
        # Wheels that turn from lock to lock take less time than the patience.
        self._stuck = self._stuck + 1 if abs(sight.speed) < STANDING else 0
        pose, size, _ = sight.movers
        if self._stuck >= (PATIENCE_MOVERS if len(pose) else PATIENCE):
            solids = sight.solids.with_boxes(*sight.others)
            # Less from those that are near already.
            room = _space(sight, pose, size, 0.0).room(rear_axle(sight.car, sight.pose))
            room = min(PASSING, room / 2)
            self._plan(sight, solids.with_boxes(pose, size + 2 * room))
        pace = self._pace(sight)
        command = self._follow(sight, pace)
        if pace == 0.0 or command is None:
            return 0.0, brake(sight.speed, sight.car, self._dt)
        self._progress = command.progress
        return command.steer, command.pedal

    def _plan(self, sight: Sight, solids: Solids) -> None:
        """Searches a path; the old one stays if there is none."""
        self._stuck = 0
        if len(self.searches) >= MAX_PLANS:
            return
        seed = *self._seed, len(self.searches)
        found = search(
            sight.pose, sight.goal, solids, sight.car, sight.extent, seed, self._config
        )
        path = found.path
        if path is not None:
            path = hurry(path, sight.car, IN_TIME * self._left)
        if path is not None or not self.searches:
            self._path, self._progress = path, Progress()
        self.searches.append(found)

    def _follow(self, sight: Sight, pace: float = FASTEST) -> Command | None:
        if self._path is None:
            return None
        driven = Driven(rear_axle(sight.car, sight.pose), sight.speed, sight.steering)
        return track(self._path, self._progress, sight.car, driven, self._dt, pace)

    def _pace(self, sight: Sight) -> float:
        """The highest speed [m/s] at which nothing gets in the way; 0 = stop."""
        if not self._is_free(sight, LOOK_AHEAD, GAP, *sight.others):
            return 0.0
        pose, size, velocity = sight.movers
        still = np.hypot(*velocity.T) < STANDING
        stand = pose[still], size[still]
        if not self._is_free(sight, ROOM, GAP * CREEP / CRUISE, *stand):
            return 0.0
        top = CRUISE if self._path is None else self._path.cruise
        for pace in PACES if top <= CRUISE else (top, *PACES):
            share = pace / CRUISE
            foreseen = FORESEEN if pace > CREEP else (0.0,)
            moves = (velocity * (share * seconds) for seconds in foreseen)
            there = [pose + np.pad(move, ((0, 0), (0, 1))) for move in moves]
            soon = np.concatenate(there), np.tile(size, (len(there), 1))
            if self._is_free(sight, LOOK_AHEAD * share, GAP * share, *soon):
                return pace
        return 0.0

    def _is_free(
        self, sight: Sight, way: float, gap: float, pose: np.ndarray, size: np.ndarray
    ) -> bool:
        """Whether boxes (k, 3), (k, 2) leave a gap to the next stretch of the path."""
        reach = math.hypot(sight.car.length, sight.car.width) + way + gap
        reach = reach + size.max(axis=-1, initial=0.0)
        near = np.hypot(*(pose[:, :2] - sight.pose[:2]).T) < reach
        path, (number, point) = self._path, self._progress
        if path is None or number == len(path.segments) or not near.any():
            return True
        segment = path.segments[number]
        ahead = segment.distance - segment.distance[point]
        points = segment.pose[(ahead >= 0) & (ahead <= way)][::10]
        return bool(_space(sight, pose[near], size[near], gap).is_free(points).all())


def _space(sight: Sight, pose: np.ndarray, size: np.ndarray, gap: float) -> FreeSpace:
    """Poses of the rear axle with a gap [m] to boxes (k, 3), (k, 2)."""
    boxes, car = Solids(pose, size, np.zeros((0, 2)), np.zeros(0)), sight.car
    wide = car.length + 2 * gap, car.width + 2 * gap
    return FreeSpace(boxes, wide, sight.extent, car.centre_offset)


SLOW = 0.7  # of an episode, for which a path is slow: less clearance is tried


class Planner:
    """Drives all agents of some lots; remembers their paths from step to step.

    `agents` has them by number of lot and agent, `decisions` counts computed actions,
    `seconds` is their CPU time, searches included [s].
    """

    def __init__(
        self,
        ctrl_dt: float,
        seed: int = 0,
        config: SearchConfig | None = None,
        seconds: float = math.inf,
    ) -> None:
        """A planner without any paths, for episodes of `seconds`; see `reset`."""
        self._dt, self._config = ctrl_dt, config or SearchConfig()
        self._seconds = seconds
        self.reset(seed)

    def reset(self, seed: int, first_lot: int = 0) -> None:
        """Removes all paths and resets the counters, for lots from `first_lot` on.

        The searches of a batch that is part of a larger one are then those of the
        larger one: each lot and agent has a seed of its own.
        """
        self.agents: dict[tuple[int, int], Agent] = {}
        self.decisions, self.seconds = 0, 0.0
        self._seed, self._first_lot = seed, first_lot

    def searches(self, lot: int, agent: int) -> list[Search]:
        """The searches of an agent's last episode, the first one at its start."""
        return self.agents[lot, agent].searches

    def act(self, seen: dict[str, Any]) -> np.ndarray:
        """Actions (lots, agents, 2) from the output of `_look`."""
        seen = jax.tree.map(np.asarray, seen)
        begun = time.thread_time()
        action = np.zeros((*seen["active"].shape, 2), np.float32)
        for lot, sights in enumerate(_sights(seen)):
            for agent, sight in sights.items():
                if (lot, agent) not in self.agents:
                    seed = self._seed, self._first_lot + lot, agent
                    own = Agent(seed, self._dt, self._config, self._seconds)
                    self.agents[lot, agent] = own
                action[lot, agent] = self.agents[lot, agent].act(sight)
                self.decisions += 1
        self.seconds += time.thread_time() - begun
        return action


def planner_policy(
    env: ParkingEnv, seed: int = 0, config: SearchConfig | None = None
) -> tuple[StatePolicy, Planner]:
    """A policy that drives on planned paths, and its memory, a `Planner`."""
    require_plannable(env)
    dt = env.config.sim.ctrl_dt
    seconds = env.config.episode.max_steps * dt
    # A path that takes most of an episode leaves no time to wait or to plan again.
    slow = min(SearchConfig.slow, SLOW * seconds)
    planner = Planner(dt, seed, config or SearchConfig(slow=slow), seconds)

    def on_host(state: State) -> jax.Array:
        seen, lead = _look(state), state.goal.shape
        if len(lead) == 1:  # a lot alone
            seen = jax.tree.map(lambda x: x[None], seen)
        shape = jax.ShapeDtypeStruct((*seen["active"].shape, 2), jnp.float32)
        return io_callback(planner.act, shape, seen).reshape(*lead, 2)

    return StatePolicy(on_host), planner


def require_plannable(env: ParkingEnv) -> None:
    """Refuses environments that the planner cannot drive in, and a lack of OMPL."""
    physics = env.config.physics_config
    if not (physics.steers and physics.actuated):
        raise ValueError(
            f"the planner needs cars with steering, motor and brakes, not those of "
            f"{physics.back_end} physics"
        )
    if env.config.goals.dynamic:
        raise ValueError("the planner needs fixed goals, goals.dynamic = False")
    require_packages("ompl", "shapely")


def sights(state: State) -> list[list[Sight]]:
    """What the present agents of lots see; of a state (lots, ...)."""
    seen = jax.tree.map(np.asarray, _look(state))
    return [[*sights.values()] for sights in _sights(seen)]


def _look(state: State) -> dict[str, Any]:
    """The planner's inputs of lots (...)."""
    layout = state.layout
    one_way = layout.one_way
    if one_way is None:
        one_way = jnp.zeros(layout.bay_mask.shape, bool)
    goal = jnp.take_along_axis(
        layout.parked_pose, state.goal[..., None], axis=-2, mode="clip"
    )
    boxes, discs = by_shape(lot_obstacles(layout, None, state.parked_cars))
    lead = state.goal.shape[:-1]
    none = jnp.zeros((*lead, 0, 2))
    movers = [Boxes(jnp.zeros((*lead, 0, 3)), none), *state.movers.groups]
    columns = zip(*(group.as_boxes for group in movers), strict=True)
    names = ("pose", "size", "velocity", "mask")
    return {
        "active": state.active,
        "begins": state.step == 0,
        "pose": state.motion.pose_w,
        "speed": state.motion.speed,
        "steering": state.motion.steering,
        "size": state.motion.size,
        "goal": goal,
        "one_way": jnp.take_along_axis(one_way, state.goal, axis=-1, mode="clip"),
        "car": state.physics.vehicle,
        **_joined("box", boxes),
        **_joined("disc", discs),
        **{
            f"mover_{name}": jnp.concatenate(column, axis=len(lead))
            for name, column in zip(names, columns, strict=True)
        },
        "extent": layout.extent,
    }


def _joined(name: str, groups: Sequence[Group]) -> dict[str, jax.Array]:
    """Poses, sizes and masks of groups (..., n) of one shape."""
    axis = groups[0].pose_w.ndim - 2
    return {
        f"{name}_{part}": jnp.concatenate([getattr(g, field) for g in groups], axis)
        for part, field in (("pose", "pose_w"), ("size", "size"), ("mask", "mask"))
    }


def _sights(seen: dict[str, Any]) -> Iterator[dict[int, Sight]]:
    """What the agents of each lot see that drive."""
    for lot, active in enumerate(seen["active"]):
        own = jax.tree.map(lambda x, lot=lot: x[lot], seen)

        def rows(name: str, *parts: str, own: Any = own) -> list[np.ndarray]:
            there = own[f"{name}_mask"]
            return [own[f"{name}_{part}"][there].astype(float) for part in parts]

        solids = Solids(*rows("box", "pose", "size"), *rows("disc", "pose", "size"))
        movers = rows("mover", "pose", "size", "velocity")
        pose, size = own["pose"].astype(float), own["size"].astype(float)
        sights: dict[int, Sight] = {}
        for agent in np.flatnonzero(active).tolist():
            others = np.arange(len(pose)) != agent
            goal = own["goal"][agent].astype(float)
            sights[agent] = Sight(
                begins=bool(own["begins"][agent]),
                pose=pose[agent],
                speed=float(own["speed"][agent]),
                steering=float(own["steering"][agent]),
                goal=goal[None] if own["one_way"][agent] else goal,
                # The arrays of a lot's cars have the names of the parameters of one.
                car=jax.tree.map(lambda x, k=agent: x[k].astype(float), own["car"]),
                solids=solids,
                others=(pose[others], size[others]),
                extent=own["extent"].astype(float),
                movers=(movers[0], movers[1], movers[2]),
            )
        yield sights


POLICIES.register("planner", lambda env: planner_policy(env)[0])
