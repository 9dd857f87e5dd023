"""The parking environment: reads like the definition of the MDP.

One `ParkingEnv` describes one lot with its agents; `jax.vmap` over keys and states
gives a batch, in which every lot may have another layout of one padded shape.
The object holds constants only; everything that changes is in `State`.
"""

import copy
import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer

from carpark_mj.compilation import (
    choose_xla_flags,
    keep_compiled_programs,
    shard_automatically,
    without_collection,
)
from carpark_mj.config import EnvConfig, LayoutConfig, insert, is_data, setting
from carpark_mj.config.checks import require_choice, require_kind
from carpark_mj.layouts import Layout, layout_config, make_layout, member_shares
from carpark_mj.layouts.registry import Split, lot_key, lot_number
from carpark_mj.mdp import actions, goals, metrics, rewards, terminations
from carpark_mj.mdp.actions import ActionSpec, action_spec
from carpark_mj.mdp.collisions import kerb_stops
from carpark_mj.mdp.progress import drives_wrong_way
from carpark_mj.observations import (
    make_fields,
    observation_size,
    observe,
    sensors,
    unpack,
)
from carpark_mj.obstacles import step_movers
from carpark_mj.physics.base import Physics, freeze
from carpark_mj.precision import float32_only, is_real, require_float32
from carpark_mj.spawning.checks import check_cars, check_exits, check_numbers
from carpark_mj.spawning.fleet import Fleet, check_randomization
from carpark_mj.spawning.reset_options import (
    ResetOptions,
    check_starts,
    read_reset_options,
)
from carpark_mj.spawning.spawner import Spawner, StepKeys
from carpark_mj.types import State, TimeStep, Transition
from carpark_mj.vehicle import VehicleParameters, drive, preset

choose_xla_flags()


class ParkingEnv:
    """N agents park in a lot; see `EnvConfig` for what can be set.

    - observation: (num_agents, observation_size) float32, `observations`.
    - action: (num_agents, 2) steer and pedal in [-1, 1], `vehicle.drive`, or other
      controls of the back end. With dynamic goals one index more: 0 = explore, k = head
      for the k-th of the tracked bays. See `action_spec`.
    - reward: (num_agents,), `mdp.rewards`.
    - episodes belong to agents: one that parks, crashes or times out respawns alone
      (or stays put, `EpisodeConfig.respawn`) while the others continue.

    Examples:
        >>> env = ParkingEnv(EnvConfig(num_agents=2))
        >>> state, observation = jax.jit(env.reset)(jax.random.key(0))
        >>> state, timestep = jax.jit(env.step)(state, jnp.zeros((2, 2)))

    Attributes:
        config: what was configured.
        vehicle: parameters of the car that `config.vehicle` names, or a custom car.
        fleet: presets that the cars are drawn from.
        layout_config: the lot, or the family it is drawn from.
        physics: the back end.
    """

    def __init__(
        self,
        config: EnvConfig | None = None,
        physics: Physics | None = None,
        vehicle: VehicleParameters | None = None,
    ) -> None:
        """Builds the constants; compiled programs are kept (`carpark_mj.compilation`).

        Args:
            config: the environment; defaults to `EnvConfig()`.
            physics: back end; defaults to the one that `config.physics` names. The
                environment's `config.physics` is then that of the object.
            vehicle: a custom car instead of the preset `config.vehicle`.

        Raises:
            ValueError: the lot cannot hold the cars, the randomization could draw an
                impossible one, there is no such preset, or JAX computes in float64.
            TypeError: the config, the back end or the car has another type.
        """
        require_float32()
        keep_compiled_programs()
        if not isinstance(config, EnvConfig | None):  # pyright: ignore
            raise TypeError(
                f"config must be an EnvConfig, not {config!r}; "
                "`carpark_mj.registry.environment` returns the named ones"
            )
        require_kind("vehicle", vehicle, VehicleParameters | None)
        config = config or EnvConfig()
        require_kind("physics", physics, Physics | None)
        if physics is not None and physics.config != config.physics_config:
            config = dataclasses.replace(config, physics=physics.config)
        self.config = config
        self.vehicle = vehicle if vehicle is not None else preset(config.vehicle)
        self.fleet = Fleet(config, self.vehicle)
        self.layout_config: LayoutConfig = layout_config(config.layout)
        fixed = not self.layout_config.is_random
        self._layout = make_layout(self.layout_config) if fixed else None
        for params in self.fleet.agents:
            check_randomization(config.randomization, params)
        check_numbers(config, self.layout_config)
        check_exits(config, self.layout_config)
        check_cars(config, self.fleet, self.layout_config, self._layout)
        make = config.physics_config.make
        self.physics: Physics = physics or make(config, self._layout, self.vehicle)
        if config.episode.kerb_speed and not self.physics.can_halt:
            raise ValueError(
                "episode.kerb_speed needs physics whose cars a kerb can stop, mjx or "
                f"bicycle, not {self.physics.config.back_end}"
            )
        self._spawner = Spawner(config, self.fleet, self.physics, self._layout)

    def with_values(self, values: Mapping[str, jax.Array | float]) -> "ParkingEnv":
        """The environment with some settings replaced by values, which may be traced.

        They are by the path of the setting, as in `reward.park`, numbers that are data
        (`carpark_mj.config.is_data`), and not checked. `ValueError` if there is no such
        setting, or another environment must be built for it.
        """
        for path in values:
            if not is_data(self.config, path):
                raise ValueError(
                    f"{path} = {setting(self.config, path)!r} decides what an "
                    "environment computes: build another with another value"
                )
        env = copy.copy(self)
        env.config = insert(self.config, values)
        env._spawner = self._spawner.with_config(env.config)
        return env

    @property
    def num_agents(self) -> int:
        """Agents in the lot."""
        return self.config.num_agents

    @property
    def observation_size(self) -> int:
        """Length of an agent's observation."""
        return observation_size(self.config)

    def unpack(self, observation: jax.Array) -> Any:
        """Observations (..., size) as adapters give them, see `observations.unpack`."""
        return unpack(make_fields(self.config), observation)

    @property
    def respawns(self) -> bool:
        """Whether `step` begins the next episodes itself."""
        return self.config.episode.respawn

    @property
    def action_spec(self) -> ActionSpec:
        """What an agent's action consists of."""
        return action_spec(self.config)

    @without_collection()
    def reset(
        self,
        key: jax.Array,
        split: Split = "train",
        member: jax.Array | None = None,
        num_present: jax.Array | None = None,
        options: ResetOptions | None = None,
    ) -> tuple[State, jax.Array]:
        """Starts a lot: its layout if it is random, parked cars, goals and agents.

        Args:
            key: consumed.
            split: lots to draw a random layout from; those of `test` are held out for
                evaluation (`carpark_mj.layouts.registry`).
            member: () int32 which member of a mixture the lot is of; drawn if None.
            num_present: () int32 how many agents the lot has, from 1 to `num_agents`;
                drawn if None, see `EnvConfig.min_agents`.
            options: start poses, speeds and goals. Impossible traced ones are not
                refused: a car inside another has crashed after the first step.

        Returns:
            The state and the observations (num_agents, observation_size).

        Raises:
            ValueError: an unknown split; unless traced, a number of agents or a member
                out of range, or impossible options.
        """
        require_choice("split", split, Split)
        members = len(member_shares(self.layout_config))
        _require_index("member", member, 0, members - 1)
        return self._start("_reset", num_present, options, split, key, member)

    @float32_only
    @shard_automatically
    def draw_layout(
        self, key: jax.Array, split: Split = "train", member: jax.Array | None = None
    ) -> Layout:
        """Draws a layout as `reset` does; all have one shape."""
        key = lot_key(lot_number(split, key))
        if member is None:
            return self.layout_config.generate(key)
        return self.layout_config.generate_member(member, key)

    def reset_to_layout(
        self,
        layout: Layout,
        key: jax.Array,
        num_present: jax.Array | None = None,
        options: ResetOptions | None = None,
    ) -> tuple[State, jax.Array]:
        """Starts a given lot, which must have enough bays for cars and goals."""
        return self._start("_begin", num_present, options, layout, key)

    def _start(
        self, method: str, num_present: Any, options: ResetOptions | None, *args: Any
    ) -> tuple[State, jax.Array]:
        _require_index("num_present", num_present, 1, self.num_agents)
        given = read_reset_options(self.config, options)
        state, observation = self._run(method, num_present, given, *args)
        if given and not _is_traced((state, given)):
            check_starts(self.config, given, state)
        return state, observation

    def _reset(
        self, present: Any, given: Any, split: Split, key: jax.Array, member: Any
    ) -> tuple[State, jax.Array]:
        if (layout := self._layout) is None:
            key, layout_key = jax.random.split(key)
            layout = self.draw_layout(layout_key, split, member)
        return self._begin(present, given, layout, key)

    @float32_only
    @shard_automatically
    def _begin(
        self, present: Any, given: Any, layout: Layout, key: jax.Array
    ) -> tuple[State, jax.Array]:
        state = self._spawner.begin_lot(layout, key, present, given)
        return state, observe(self.config, state)

    @without_collection()
    @float32_only
    @shard_automatically
    def step(self, state: State, action: jax.Array) -> tuple[State, TimeStep]:
        """Advances the lot by one control step.

        Args:
            state: current state.
            action: (num_agents, action_spec.size); agents that have finished, or are
                absent, brake instead. What is NaN or out of range is sanitized and
                counted in the metric `invalid_actions`.

        Returns:
            The next state, and what agents get from the step.

        Raises:
            ValueError: an action of another shape.
        """
        shape = (self.config.num_agents, self.action_spec.size)
        if action.shape != shape:
            raise ValueError(f"action must be of shape {shape}, not {action.shape}")
        return self._run("_step", state, action)

    def _run(self, method: str, *args: Any) -> Any:
        # Outside of `jax.jit`, JAX would compile every operation, and loops each time.
        run = getattr(self, method) if _is_traced(args) else self._compiled[method]
        return run(*args)

    @functools.cached_property
    def _compiled(self) -> dict[str, Callable[..., Any]]:
        reset = jax.jit(self._reset, static_argnums=2)  # the split
        begin, step = jax.jit(self._begin), jax.jit(self._step)
        return {"_reset": reset, "_begin": begin, "_step": step}

    def __getstate__(self) -> dict[str, Any]:
        # Copies are other environments, and programs cannot be pickled.
        return {k: x for k, x in vars(self).items() if k != "_compiled"}

    def _step(self, state: State, action: jax.Array) -> tuple[State, TimeStep]:
        config, before = self.config, state
        keys = self._spawner.split_keys(state.key)
        act = actions.parse(config, self._stop_finished(before, action))
        after = goals.choose_goals(config, before, act.goal_choice)
        controls, braked = self._brake(after, act.controls)
        after = self._move(after, controls, keys)
        with jax.named_scope("terminations"):
            events = terminations.detect_events(config.episode, after)
            state = self._spawner.end(after, events, keys.relocate)
        with jax.named_scope("goals"):
            state, goal_events = goals.update_goals(config, before, state, events)
            target = goals.target_bays(after)
        layout = after.layout
        transition = Transition(
            before,
            after,
            target_pose=layout.parked_pose[target],
            events=events,
            goal_events=goal_events,
            wrong_way=drives_wrong_way(layout, after.motion),
            invalid_action=act.invalid,
            one_way=None if layout.one_way is None else layout.one_way[target],
            braked=braked,
        )
        with jax.named_scope("rewards"):
            terms = rewards.reward_terms(config, transition)
        with jax.named_scope("metrics"):
            stats = metrics.update_stats(config, transition, terms)
        state = dataclasses.replace(state, stats=stats, key=keys.next)
        if config.episode.respawn:
            with jax.named_scope("spawning"):
                state = self._spawner.spawn(state, events.done, keys.spawn)
        with jax.named_scope("observations"):
            observation = observe(config, state)
            final_observation = None
            if config.episode.final_observation:
                final_observation = observe(config, goals.track_bays(config, after))
        return state, TimeStep(
            observation=observation,
            reward=jnp.sum(jnp.stack(list(terms.values())), axis=0),
            terminated=events.parked | events.crashed,
            truncated=events.timed_out | events.diverged,
            events=events,
            metrics=metrics.episode_metrics(transition, stats),
            reward_terms=terms,
            motion=after.motion,
            goal=after.goal,
            goal_events=goal_events,
            target_pose=transition.target_pose,
            final_observation=final_observation,
        )

    def _brake(
        self, state: State, wanted: jax.Array
    ) -> tuple[jax.Array, jax.Array | None]:
        """Controls (num_agents, 2) of automatic brakes, and whose they overrode."""
        if not (self.config.sim.emergency_brake or self.config.sim.manoeuvre_brake):
            return wanted, None
        from carpark_mj.physics import emergency_brake  # only such cars load it

        controls = emergency_brake.override(self.config.sim, state, wanted)
        return controls, (controls != wanted).any(axis=-1)

    def _move(self, state: State, controls: jax.Array, keys: StepKeys) -> State:
        """The state when the cars have moved and their motion has been measured."""
        config, memory = self.config, self.config.observation.remember(state)
        ours, dt = self._spawner.movers, config.sim.ctrl_dt
        movers = step_movers(ours, state, dt, keys.movers)
        groups = state.movers.groups, movers.groups
        physics = self.physics.step_among(state.physics, controls, *groups)
        motion = self.physics.read(physics)
        if config.episode.kerb_speed:
            stops = kerb_stops(config, state, motion)
            physics = self.physics.halt(physics, *stops)
            motion = self.physics.read(physics)
        all_drive = config.episode.respawn and state.present is None
        if not (all_drive or config.physics_config.contacts):
            physics, motion = freeze(state, physics, motion)
        pose_w = self.physics.parked_poses(physics, state.parked_cars.pose_w)
        return dataclasses.replace(
            state,
            physics=physics,
            motion=motion,
            parked_cars=dataclasses.replace(state.parked_cars, pose_w=pose_w),
            memory=memory,
            movers=movers,
            step=state.step + state.active,
            sensors=sensors.measure(config.sensors, state, motion, keys.reading),
        )

    def _stop_finished(self, state: State, action: jax.Array) -> jax.Array:
        """Actions (num_agents, size); of agents that are not active, the brake."""
        spec, physics = self.action_spec, self.config.physics_config
        if not (spec.continuous or physics.contacts):  # they are frozen anyway
            return action
        stop = spec.middle
        if physics.steers:
            stop = drive.stopping_action(state.motion.speed)
            stop = jnp.pad(stop, ((0, 0), (0, spec.size - 2)))
        return jnp.where(state.active[:, None], action, stop).astype(spec.dtype)


def _is_traced(tree: Any) -> bool:
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def _require_index(name: str, value: Any, least: int, most: int) -> None:
    """Refuses a value that is not a whole number () within bounds, unless traced."""
    whole = isinstance(value, int) or (is_real(value) and value.dtype.kind in "iu")
    if value is not None and not (whole and jnp.ndim(value) == 0):
        raise ValueError(f"{name} must be a whole number, not {value!r}")
    if not isinstance(value, Tracer | None) and not least <= int(value) <= most:
        raise ValueError(f"{name} must lie in [{least}, {most}], not {value}")
