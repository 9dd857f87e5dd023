"""A batch of lots, reset and stepped by one compiled call, and its pictures.

All adapters build on a batch, as JAX or NumPy arrays, or as torch tensors (`torchrl`).
Observations are arrays, or dictionaries of arrays where `ParkingEnv.unpack` gives some.
"""

import copy
import dataclasses
import functools
import inspect
import types
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.error import ResetNeeded

from carpark_mj.config.checks import require_count, require_seed
from carpark_mj.geometry import axis_angle_error, norm
from carpark_mj.mdp.goals import target_bays
from carpark_mj.mdp.rewards import term_weights
from carpark_mj.physics.base import where_cars
from carpark_mj.precision import is_real
from carpark_mj.rendering.gl import missing_display
from carpark_mj.rendering.recording import snapshot_of
from carpark_mj.rendering.renderer import LotRenderer, RenderingError
from carpark_mj.rendering.stage import Snapshot, Stage
from carpark_mj.scene import camera_flags
from carpark_mj.spawning.reset_options import ResetOptions, check_starts
from carpark_mj.tasks.environment import Environment
from carpark_mj.types import Motion, State, TimeStep

# Lots that are restarted together: the share of a batch that ends in a step of long
# episodes. A batch restarts as many such groups as it takes.
_GROUP = 1 / 32

# Of the first lot (the next lot has the next seed), or of each lot. None = drawn.
Seeds = int | Sequence[int | None] | None


class Batch:
    """`num_lots` lots of one environment `env` on JAX's device.

    With `EpisodeConfig.respawn` each agent auto-resets in its lot. Without it, agents
    wait until all of their lot have finished. The lot then resets in the same call,
    with another layout if it is random.
    """

    def __init__(self, env: Environment, num_lots: int, restart: bool = True) -> None:
        """With `restart` a lot resets when all its agents have finished."""
        require_count("num_lots", num_lots, 1)
        self.env: Any = env  # adapters know of which kind
        self.num_lots, self._restart = num_lots, restart
        self._programs = _programs(env, restart)
        self._state: State | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in vars(self).items() if k != "_programs"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._programs = _programs(self.env, self._restart)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        other = copy.copy(self)  # environments hold constants only
        other._state = jax.tree.map(lambda x: x.copy(), self._state)
        return other

    @property
    def state(self) -> State:
        """State (num_lots, ...) of the lots; the next step reuses its buffers."""
        if self._state is None:
            raise ResetNeeded("call reset before the first step")
        return self._state

    @property
    def action_shape(self) -> tuple[int, int, int]:
        """Shape of the actions: lots, agents, size."""
        return self.num_lots, self.env.num_agents, self.env.action_spec.size

    def reset(self, seed: Seeds = None, options: ResetOptions | None = None) -> Any:
        """Begins all lots.

        Args:
            seed: in [0, 2**32); lot i gets seed + i, or the i-th of a sequence. None =
                lots go on with their own random numbers, at first unpredictable ones.
            options: (num_lots, num_agents, ...) given starts of the first episodes;
                later ones are drawn.

        Returns:
            Observations (num_lots, num_agents, ...).

        Raises:
            ValueError: impossible seeds or options; the lots stay as they were.
        """
        if seed is None and self._state is not None:
            keys = self._state.key
        else:
            keys = self._programs.keys(_seeds(seed, self.num_lots))
        takes = inspect.signature(self.env.reset).parameters
        if options is not None and "options" not in takes:
            raise ValueError(f"{type(self.env).__name__}.reset takes no options")
        state, observation = self._programs.reset(keys, options)
        if options is not None:
            check_starts(self.env.config, options, state)
        self._state = state
        return observation

    def restart(
        self, due: np.ndarray | jax.Array, seed: Seeds = None, key: Any = None
    ) -> Any:
        """Resets some lots, `due` (num_lots,) bool.

        They go on with their own random numbers, or those of seeds, see `reset`, or of
        keys (num_lots,). Returns observations as `reset` does; zeros for the others.
        """
        due, state = jnp.asarray(due), self.state
        if seed is not None:
            key = self._programs.keys(_seeds(seed, self.num_lots))
        if key is not None:
            key = jnp.where(due, key, state.key)
            state = dataclasses.replace(state, key=key)
        self._state, seen = self._programs.restart(state, due)
        return seen

    def step(self, action: jax.Array | np.ndarray) -> TimeStep:
        """Advances all lots by a control step; actions are of `action_shape`.

        All of the time step is (num_lots, num_agents, ...). Where an episode has begun,
        `observation` is that of the new episode and `final_observation` the last of
        the old one.
        """
        require_shape("actions", action, self.action_shape)
        self._state, timestep = self._programs.step(self.state, action)
        return timestep


class Step(NamedTuple):
    """A step as learners need it, in the arrays of their library.

    All have the leading shape (num_lots, num_agents), see `TimeStep` and `Batch.step`;
    `success` is `Events.success`. There are final observations unless agents respawn
    without `EpisodeConfig.final_observation`.
    """

    observation: Any
    final_observation: Any
    reward: Any
    terminated: Any
    truncated: Any
    success: Any
    crashed: Any

    @classmethod
    def of(cls, timestep: TimeStep, convert: Callable[[jax.Array], Any]) -> "Step":
        """Converts what learners need of a time step, array by array."""
        values = [getattr(timestep, name) for name in cls._fields[:-2]]
        values += [timestep.events.success, timestep.events.crashed]
        return cls._make(jax.tree.map(convert, values))


class NumpyBatch(Batch):
    """A batch with NumPy arrays, which the caller may keep and change."""

    _timestep: TimeStep | None = None  # the last

    def reset_numpy(
        self, seed: Seeds = None, options: ResetOptions | None = None
    ) -> Any:
        """See `reset`."""
        return jax.tree.map(np.array, self.reset(seed, options))

    def step_numpy(self, action: Any) -> Step:
        """See `step`; refuses NaN, and numbers that are no integers on the grid."""
        given = np.asarray(action)
        if not is_real(given):
            raise ValueError(f"actions must be real numbers, not {given.dtype}")
        require_shape("actions", given, self.action_shape)
        with np.errstate(invalid="ignore"):  # of NaN as an integer
            action = given.astype(self.env.action_spec.dtype)
        whole = np.issubdtype(action.dtype, np.integer)
        wrong = ~np.isfinite(given) | (whole & (action != given))
        if wrong.any():
            lot, agent, part = np.argwhere(wrong)[0]
            raise ValueError(
                f"actions must be {'integers' if whole else 'finite numbers'}, not "
                f"{given[lot, agent, part]} (lot {lot}, agent {agent})"
            )
        self._timestep = self.step(action)
        return Step.of(self._timestep, np.array)

    def details(self, of_step: bool) -> dict[str, np.ndarray]:
        """`details` (num_lots, num_agents, ...) at the end of the last step.

        Otherwise as agents stand now, where some have begun anew, with rewards of 0.
        """
        if of_step:
            assert self._timestep is not None
            step = self._timestep
            found = details(step.motion, step.target_pose, step.reward_terms)
        else:
            zero = np.zeros(self.action_shape[:2], np.float32)
            paid = dict.fromkeys(term_weights(self.env.config), zero)
            found = details(self.state.motion, _targets(self.state), paid)
        return jax.tree.map(np.array, found)


@jax.jit
def details(
    motion: Motion, goal: jax.Array, terms: Mapping[str, jax.Array]
) -> dict[str, jax.Array]:
    """What infos have on request of agents (...), their goals' poses and rewards.

    `pose` and `goal` (..., 3) [m, m, rad], `speed` [m/s], `goal_distance` of centres
    [m], `goal_heading`, the angle to the bay's axis [rad], and `reward_TERM`.
    """
    return {
        "pose": motion.pose_w,
        "speed": motion.speed,
        "goal": goal,
        "goal_distance": norm(motion.xy - goal[..., :2]),
        "goal_heading": axis_angle_error(motion.pose_w[..., 2] - goal[..., 2]),
        **{f"reward_{name}": term for name, term in terms.items()},
    }


@jax.jit
@jax.vmap
def _targets(state: State) -> jax.Array:
    """Poses (num_lots, num_agents, 3) of the bays that agents head for."""
    return state.layout.parked_pose[target_bays(state)]


def require_shape(
    name: str, array: jax.Array | np.ndarray, shape: tuple[int, ...] | None
) -> None:
    """Refuses an array of another shape."""
    if array.shape != shape:
        raise ValueError(f"{name} must have the shape {shape}, not {array.shape}")


def require_render_mode(render_mode: str | None, modes: Sequence[str]) -> None:
    """Refuses a mode other than None and those given."""
    if render_mode not in (None, *modes):
        raise ValueError(f"unknown render_mode {render_mode!r}; choose from {modes}")


class _Programs(NamedTuple):
    """The compiled functions of an environment's batches, whatever their size."""

    keys: Callable[[np.ndarray], jax.Array]
    reset: Callable[[jax.Array, ResetOptions | None], tuple[State, Any]]
    restart: Callable[[State, jax.Array], tuple[State, Any]]
    step: Callable[[State, Any], tuple[State, TimeStep]]


@functools.lru_cache(maxsize=32)
def _programs(env: Environment, restart: bool) -> _Programs:
    restart = restart and not env.respawns
    unpack = getattr(env, "unpack", lambda observation: observation)

    def step(state: State, action: jax.Array) -> tuple[State, TimeStep]:
        state, timestep = jax.vmap(env.step)(state, action)
        seen, final = timestep.observation, timestep.final_observation
        if restart:
            final = seen
            state, seen = _restart(env, state, seen, ~state.active.any(axis=1))
        return state, dataclasses.replace(
            timestep,
            observation=unpack(seen),
            final_observation=None if final is None else unpack(final),
        )

    def reset(key: jax.Array, options: ResetOptions | None) -> tuple[State, Any]:
        given: Any = {} if options is None else {"options": options}
        state, seen = jax.vmap(env.reset)(key, **given)
        return state, unpack(seen)

    def restart_due(state: State, due: jax.Array) -> tuple[State, Any]:
        seen = jax.eval_shape(jax.vmap(env.reset), state.key)[1]
        none = jnp.zeros(seen.shape, seen.dtype)
        state, seen = _restart(env, state, none, due)
        return state, unpack(seen)

    # The state is the batch's own, so its buffers can be used again.
    return _Programs(
        jax.jit(jax.vmap(jax.random.key)),
        jax.jit(reset),
        jax.jit(restart_due, donate_argnums=0),
        jax.jit(step, donate_argnums=0),
    )


_Lots = tuple[tuple[State, jax.Array], jax.Array]  # with observations; which are due


def _restart(
    env: Environment, state: State, observation: jax.Array, due: jax.Array
) -> tuple[State, jax.Array]:
    """Resets the lots that are due (num_lots,), some at a time; the rest are kept."""
    num_lots = due.shape[0]
    count = max(1, round(num_lots * _GROUP))

    def group(carry: _Lots) -> _Lots:
        old, due = carry
        (lots,) = jnp.nonzero(due, size=count, fill_value=num_lots)
        fresh = jax.vmap(env.reset)(old[0].key[jnp.minimum(lots, num_lots - 1)])
        is_drawn = lots[:, None] == jnp.arange(num_lots)
        source, drawn = jnp.argmax(is_drawn, axis=0), is_drawn.any(axis=0)
        # Gathered, not scattered: XLA aborts where it fuses scatters on a CPU (0.10).
        fresh = jax.tree.map(lambda x: x[source], fresh)
        return where_cars(drawn, fresh, old), due & ~drawn

    carry = (state, observation), due
    return jax.lax.while_loop(lambda carry: carry[1].any(), group, carry)[0]


def _seeds(seed: Seeds, num_lots: int) -> np.ndarray:
    """A seed (num_lots,) uint32 for each lot; None is drawn."""
    drawn = np.random.SeedSequence().generate_state(num_lots)
    if seed is None:
        return drawn
    given = list(seed) if isinstance(seed, Sequence | np.ndarray) else [seed]
    for each in given:
        if each is not None:
            require_seed(each)
    if isinstance(seed, int | np.integer):
        given = [(int(seed) + i) % 2**32 for i in range(num_lots)]
    if len(given) != num_lots:
        raise ValueError(f"seeds must be one for each of {num_lots} lots, not {seed}")
    pairs = zip(given, drawn, strict=True)
    return np.array([d if s is None else s for s, d in pairs], np.uint32)


WIDTH, HEIGHT = 960, 540  # pixels
RENDER_MODES = ["human", "rgb_array"]


class Screen:
    """Shows lots of one environment; lots that look alike share a scene."""

    def __init__(
        self,
        env: Any,
        camera: str = "topdown",
        num_cars: int | None = None,
        width: int = WIDTH,
        height: int = HEIGHT,
    ) -> None:
        """Opens nothing yet; the camera is one of `scene.camera_flags.camera_names`.

        `env` is a `ParkingEnv`, or what a subclass draws; `num_cars` cars can be
        followed, None = the agents. Sizes are of pictures [pixels].
        """
        require_count("width", width, 2, camera_flags.OFFSCREEN_WIDTH)
        require_count("height", height, 2, camera_flags.OFFSCREEN_HEIGHT)
        number = env.num_agents if num_cars is None else num_cars
        camera_flags.camera_names(camera, number)
        self._env, self._camera, self._size = env, camera, (width, height)
        self._open_nothing()

    def _open_nothing(self) -> None:
        self._stages: dict[bytes, Stage] = {}  # the last is the one used last
        self._renderer: LotRenderer | None = None
        self._window: Any = None
        self._in_window: Stage | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Copies open their own windows and renderers."""
        return {name: vars(self)[name] for name in ("_env", "_camera", "_size")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._open_nothing()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return copy.copy(self)

    def picture(self, state: Any, lot: int = 0) -> np.ndarray:
        """Draws a lot of a batch, (height, width, 3) uint8; it needs OpenGL."""
        stage, seen = self._place(state, lot)
        if self._renderer is None:
            self._renderer = LotRenderer(stage, self._camera, self._size)
        self._renderer.show_lot(stage)
        draw, cameras = self._renderer.draw, self._renderer.cameras
        return np.concatenate([draw(seen, name) for name in cameras], axis=1)

    def show(self, state: Any, lot: int = 0) -> None:
        """Shows a lot of a batch in MuJoCo's window; it needs a display."""
        if missing := missing_display():  # MuJoCo's viewer would end the program
            raise RenderingError(
                f"render_mode 'human': {missing}; 'rgb_array' needs none"
            )
        stage, _ = self._place(state, lot)
        if stage is not self._in_window:
            self._close_window()
            import mujoco.viewer

            self._window = mujoco.viewer.launch_passive(stage.model, stage.data)
            self._in_window = stage
        self._window.sync()

    def close(self) -> None:
        """Closes what is open; it opens again if used."""
        if self._renderer is not None:
            self._renderer.close()
        self._close_window()
        self._renderer, self._stages = None, {}

    def _close_window(self) -> None:
        if self._window is not None:
            self._window.close()
        self._window = self._in_window = None

    def _place(self, state: Any, lot: int) -> tuple[Stage, Snapshot]:
        """The scene of a lot with its cars in their places."""
        names = ("layout", "motion", "parked_cars", "goal", "active", "movers", "kind")
        parts = {name: getattr(state, name) for name in names}
        parts = jax.device_get(jax.tree.map(lambda x: x[lot], parts))
        seen: Any = types.SimpleNamespace(**parts)
        stage = self._stage(seen, most=len(state.goal))
        snapshot = snapshot_of(seen)
        stage.place(snapshot)
        return stage, snapshot

    def _stage(self, state: Any, most: int) -> Stage:
        """The scene of a lot and its parked cars; the `most` used last are kept."""
        cars, sizes = state.parked_cars, [x.size for x in state.movers.groups]
        drawn = jax.tree.leaves((state.layout, cars.size, cars.kind, sizes))
        key = b"".join(part.tobytes() for part in drawn)
        stage = self._stages.pop(key, None) or Stage.of(self._env, state)
        self._stages[key] = stage
        if len(self._stages) > most:
            del self._stages[next(iter(self._stages))]
        return stage
