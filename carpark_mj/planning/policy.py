"""The planner as a policy: `--policy planner`."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import io_callback

from carpark_mj.env import ParkingEnv
from carpark_mj.geometry.obstacles import Boxes, Group, by_shape
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.planning.driving import Agent, Sight
from carpark_mj.planning.obstacles import Solids
from carpark_mj.planning.search import Search, SearchConfig, require_ompl
from carpark_mj.policy.acting import StatePolicy
from carpark_mj.types import State

SLOW = 0.7  # of an episode, for which a path is slow: more are searched for


class Planner:
    """Drives all agents of some lots; remembers their paths from step to step.

    Attributes:
        agents: their paths and progress, by number of lot and agent.
        decisions: number of actions computed.
        seconds: CPU time of these, searches included [s].
    """

    def __init__(
        self, ctrl_dt: float, seed: int = 0, config: SearchConfig | None = None
    ) -> None:
        """A planner without any paths.

        Args:
            ctrl_dt: control period [s].
            seed: see `reset`.
            config: how to search; the defaults if None.
        """
        self._dt, self._config = ctrl_dt, config or SearchConfig()
        self.reset(seed)

    def reset(self, seed: int, first_lot: int = 0) -> None:
        """Removes all paths and resets the counters, for other lots.

        Args:
            seed: of the searches, another one for each lot and agent.
            first_lot: number of the first lot of a batch that is part of a larger one:
                the searches are then those of the larger one.
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
        lots, agents = seen["active"].shape
        action = np.zeros((lots, agents, 2), np.float32)
        for lot in range(lots):
            solids = _solids(seen, lot)
            for agent in np.flatnonzero(seen["active"][lot]):
                sight = _sight(seen, lot, int(agent), solids)
                action[lot, agent] = self._agent(lot, int(agent)).act(sight)
                self.decisions += 1
        self.seconds += time.thread_time() - begun
        return action

    def _agent(self, lot: int, agent: int) -> Agent:
        if (lot, agent) not in self.agents:
            seed = self._seed, self._first_lot + lot, agent
            self.agents[lot, agent] = Agent(seed, self._dt, self._config)
        return self.agents[lot, agent]


def planner_policy(
    env: ParkingEnv, seed: int = 0, config: SearchConfig | None = None
) -> tuple[StatePolicy, Planner]:
    """A policy that drives on planned paths, and its memory; arguments of `Planner`.

    Raises:
        ValueError: OMPL is not installed, or agents choose their goals, or cars do not
            obey a pedal.
    """
    require_plannable(env)
    dt = env.config.sim.ctrl_dt
    seconds = env.config.episode.max_steps * dt
    # A path that takes most of an episode leaves no time to wait or to plan again.
    slow = min(SearchConfig.slow, SLOW * seconds)
    planner = Planner(dt, seed, config or SearchConfig(slow=slow))
    return StatePolicy(_callback(planner.act)), planner


def require_plannable(env: ParkingEnv) -> None:
    """Refuses environments that the planner cannot drive in.

    Raises:
        ValueError: OMPL is not installed, or agents choose their goals, or cars do not
            obey a pedal.
    """
    physics = env.config.physics_config
    if not (physics.steers and physics.actuated):
        raise ValueError(
            f"the planner needs cars with steering, motor and brakes, not those of "
            f"{physics.back_end} physics"
        )
    if env.config.goals.dynamic:
        raise ValueError("the planner needs fixed goals, goals.dynamic = False")
    require_ompl()


def sights(state: State) -> list[list[Sight]]:
    """What the present agents of lots see; of a state (lots, ...)."""
    seen = jax.tree.map(np.asarray, _look(state))
    return [
        [
            _sight(seen, lot, int(agent), _solids(seen, lot))
            for agent in np.flatnonzero(active)
        ]
        for lot, active in enumerate(seen["active"])
    ]


def _callback(act: Callable[[dict[str, Any]], np.ndarray]) -> Any:
    def on_host(state: State) -> jax.Array:
        seen, lead = _look(state), state.goal.shape
        if len(lead) == 1:  # a lot alone
            seen = jax.tree.map(lambda x: x[None], seen)
        shape = jax.ShapeDtypeStruct((*seen["active"].shape, 2), jnp.float32)
        return io_callback(act, shape, seen).reshape(*lead, 2)

    return on_host


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
    nothing = Boxes(jnp.zeros((*lead, 0, 3)), jnp.zeros((*lead, 0, 2)))
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
        **_joined("mover", [nothing, *map(_outlines, state.movers.groups)]),
        "mover_velocity": _velocities(state),
        "extent": layout.extent,
    }


def _joined(name: str, groups: Sequence[Group]) -> dict[str, jax.Array]:
    """Poses, sizes and masks of groups (..., n) of one shape."""
    masks = [
        jnp.ones(g.pose_w.shape[:-1], bool) if g.mask is None else g.mask
        for g in groups
    ]
    axis = masks[0].ndim - 1
    return {
        f"{name}_pose": jnp.concatenate([group.pose_w for group in groups], axis),
        f"{name}_size": jnp.concatenate([group.size for group in groups], axis),
        f"{name}_mask": jnp.concatenate(masks, axis),
    }


def _outlines(group: Group) -> Boxes:
    """Boxes about the obstacles of a group (..., n)."""
    if isinstance(group, Boxes):
        return group
    pose = jnp.pad(group.pose_w, [(0, 0)] * (group.pose_w.ndim - 1) + [(0, 1)])
    return Boxes(pose, jnp.stack([2 * group.size] * 2, axis=-1), mask=group.mask)


def _velocities(state: State) -> jax.Array:
    """(..., n, 2) of all movers [m/s]."""
    found = [jnp.zeros((*state.goal.shape[:-1], 0, 2))]
    for group in state.movers.groups:
        still = jnp.zeros((*group.pose_w.shape[:-1], 2))
        found.append(still if group.velocity_w is None else group.velocity_w)
    return jnp.concatenate(found, axis=-2)


def _solids(seen: dict[str, Any], lot: int) -> Solids:
    boxes, discs = seen["box_mask"][lot], seen["disc_mask"][lot]
    return Solids(
        seen["box_pose"][lot][boxes].astype(float),
        seen["box_size"][lot][boxes].astype(float),
        seen["disc_pose"][lot][discs].astype(float),
        seen["disc_size"][lot][discs].astype(float),
    )


def _sight(seen: dict[str, Any], lot: int, agent: int, solids: Solids) -> Sight:
    pose = seen["pose"][lot].astype(float)
    others = np.arange(len(pose)) != agent
    moving = seen["mover_mask"][lot]
    pose_m, size_m, velocity_m = (
        seen[f"mover_{name}"][lot][moving].astype(float)
        for name in ("pose", "size", "velocity")
    )
    goal = seen["goal"][lot, agent].astype(float)
    return Sight(
        begins=bool(seen["begins"][lot, agent]),
        pose=pose[agent],
        speed=float(seen["speed"][lot, agent]),
        steering=float(seen["steering"][lot, agent]),
        goal=goal[None] if seen["one_way"][lot, agent] else goal,
        # The arrays of a lot's cars have the names of the parameters of one.
        car=jax.tree.map(lambda x: x[lot, agent].astype(float), seen["car"]),
        solids=solids,
        others=(pose[others], seen["size"][lot][others].astype(float)),
        movers=(pose_m, size_m, velocity_m),
        extent=seen["extent"][lot].astype(float),
    )
