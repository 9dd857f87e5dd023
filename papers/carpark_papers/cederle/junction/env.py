"""The junction environment: reads like the definition of the MDP.

As `carpark_mj.env.ParkingEnv`: the object holds constants only, `jax.vmap` over keys
and states gives a batch.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.physics.base import where_cars
from carpark_mj.physics.bicycle import BicyclePhysics
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.precision import float32_only
from carpark_mj.vehicle import preset
from carpark_papers.cederle.junction import observations, rules
from carpark_papers.cederle.junction.cars import Cars, PathCars, SteeredCars
from carpark_papers.cederle.junction.config import JunctionConfig
from carpark_papers.cederle.junction.roads import (
    SPEED_LIMIT,
    point_at,
    project,
    stack_routes,
)
from carpark_papers.cederle.junction.rules import State, Task, TimeStep


class JunctionEnv:
    """Automated cars, and perhaps a human-driven one, cross a T-junction.

    - observation: (num_agents, *observation_shape), float32 vectors or uint8 images.
    - action: (num_agents,) or (num_agents, 1), an index of `rules.ACTIONS`, or a
      number that stands for one.
    - reward: (num_agents,), see `rules.reward`.
    - episodes belong to the junction: with `JunctionConfig.end` "any" it is over as
      soon as one agent is done, with "all" when all are.

    Examples:
        >>> env = JunctionEnv(JunctionConfig(scenario="3av-hd"))
        >>> state, observation = jax.jit(env.reset)(jax.random.key(0))
        >>> state, timestep = jax.jit(env.step)(state, jnp.zeros(3, int))

    Attributes:
        config: what was configured.
        num_agents: automated cars.
        num_cars: all cars.
    """

    def __init__(self, config: JunctionConfig | None = None) -> None:
        """Builds the constants."""
        self.config = config = config if config is not None else JunctionConfig()
        traffic = config.traffic
        missions, humans = traffic.missions, traffic.human_cars
        self.num_agents, self.num_cars = len(missions), len(missions) + len(humans)
        self._routes = stack_routes([car.route for car in (*missions, *humans)])
        self._start = jnp.array([car.start for car in (*missions, *humans)])
        goals = [mission.goal_along for mission in missions]
        self._goal = jnp.array(goals)
        entry = [SPEED_LIMIT] * len(missions)
        self._speed = jnp.array(entry + [human.speed for human in humans])
        self._cars = make_cars(config)
        # The start is drawn once where all episodes begin alike.
        self._first_image: np.ndarray | None = None
        if config.observation == "image" and not (config.shuffle or config.jitter):
            state = jax.jit(self._begin)(jax.random.key(0))
            self._first_image = np.asarray(jax.jit(self._draw)(state))

    @property
    def agents(self) -> list[str]:
        """Names of the agents, in order."""
        return [f"agent_{k}" for k in range(self.num_agents)]

    @property
    def respawns(self) -> bool:
        """Whether `step` begins the next episode itself."""
        return self.config.respawn

    @property
    def observation_shape(self) -> tuple[int, ...]:
        """Of one agent."""
        if self.config.observation == "vector":
            return (observations.vector_size(self.num_cars),)
        raster = self.config.raster
        return raster.pixels, raster.pixels, raster.frames

    @property
    def action_spec(self) -> ActionSpec:
        """One index, or one number."""
        return rules.INDEX if self.config.action == "index" else rules.SCALAR

    @float32_only
    def reset(self, key: jax.Array) -> tuple[State, jax.Array]:
        """State and observations (num_agents, *observation_shape) of a new episode."""
        state = self._begin(key)
        if self.config.observation == "image":
            image = self._first_image
            image = self._draw(state) if image is None else jnp.asarray(image)
            frames = jnp.repeat(image[..., None], self.config.raster.frames, axis=-1)
            state = dataclasses.replace(state, frames=frames)
        return _own_buffers(state), self._observe(state)

    def _begin(self, key: jax.Array) -> State:
        """The state at the start of an episode, still without images."""
        n, cars = self.num_agents, self.num_cars
        key, deal_key, jitter_key = jax.random.split(key, 3)
        order = jnp.arange(cars)
        if self.config.shuffle:
            order = order.at[:n].set(jax.random.permutation(deal_key, n))
        jitter = self.config.jitter
        offset = jax.random.uniform(jitter_key, (n,), minval=-jitter, maxval=jitter)
        start = self._start[order].at[:n].add(offset)
        routes = jax.tree.map(lambda x: x[order], self._routes)
        own = jax.tree.map(lambda x: x[:n], routes)
        dealt = order if self.config.shuffle else None
        task = Task(routes, start, point_at(own, self._goal[order[:n]]), dealt)
        begun = self._cars.init(routes, start, self._speed)
        state = State(
            cars=begun,
            motion=self._cars.read(begun),
            along=start,
            task=task,
            present=jnp.ones(cars, bool),
            active=jnp.ones(n, bool),
            unpaid=jnp.zeros(n),
            returns=jnp.zeros(n),
            frames=None,
            step=jnp.zeros((), jnp.int32),
            key=key,
        )
        if self.config.probe:
            slow = jnp.full(n, rules.SLOW_DOWN)
            state = dataclasses.replace(self._move(state, slow), step=state.step)
        return state

    @float32_only
    def step(self, state: State, action: jax.Array) -> tuple[State, TimeStep]:
        """Advances by one control step.

        Actions are (num_agents,) or (num_agents, 1); actions of finished agents are
        ignored.
        """
        config, before, n = self.config, state, self.num_agents
        state = self._move(before, rules.parse(self.action_spec, action))
        events = rules.detect_events(state, config.max_steps)
        unpaid = before.unpaid + (state.along - before.along)[:n]
        progress, unpaid = rules.pay_progress(jnp.where(before.active, unpaid, 0.0))
        reward = rules.reward(config.rewards, progress, events)
        done = events.terminal | events.timed_out | events.diverged
        if config.end == "any":
            done = jnp.broadcast_to(done.any(), done.shape)
        truncated = done & ~events.terminal & before.active
        if config.end == "any":
            truncated = truncated & ~events.terminal.any()
        active = before.active & ~done
        state = dataclasses.replace(
            state, unpaid=unpaid, active=active, returns=before.returns + reward
        )
        if before.frames is not None:
            frames = jnp.concatenate(
                [before.frames[..., 1:], self._draw(state)[..., None]], axis=-1
            )
            state = dataclasses.replace(state, frames=frames)
        seen = self._observe(state)
        waiting = jnp.expand_dims(~before.active, range(1, seen.ndim))
        seen = jnp.where(waiting, jnp.zeros_like(seen), seen)
        timestep = TimeStep(
            observation=seen,
            reward=reward,
            terminated=(done & ~truncated) | ~before.active,
            truncated=truncated,
            events=events,
            motion=state.motion,
            returns=state.returns,
            over=~active.any(),
            final_observation=seen,
        )
        if config.respawn:
            fresh, first = self.reset(state.key)
            state = where_cars(timestep.over, fresh, state)
            observation = jnp.where(timestep.over, first, seen)
            timestep = dataclasses.replace(timestep, observation=observation)
        return _own_buffers(state), timestep

    def _move(self, state: State, action: jax.Array) -> State:
        """The state after the cars have moved; agents that had finished have left."""
        n, routes = self.num_agents, state.task.routes
        keep = jnp.full(self.num_cars - n, rules.KEEP_LANE, action.dtype)
        action = jnp.where(state.active, action, rules.SLOW_DOWN)
        target = rules.target_speeds(jnp.concatenate([action, keep]))
        cars = self._cars.step(state.cars, routes, target)
        motion = self._cars.read(cars)
        along = project(routes, motion.xy)[0]
        gone = (along >= routes.length - LEAVING).at[:n].set(False)
        return dataclasses.replace(
            state,
            cars=cars,
            motion=motion,
            along=along,
            present=state.present.at[:n].set(state.active) & ~gone,
            step=state.step + 1,
        )

    def _draw(self, state: State) -> jax.Array:
        return observations.draw(self.config.raster, state)

    def _observe(self, state: State) -> jax.Array:
        return observations.observe(state) if state.frames is None else state.frames


LEAVING = 0.01  # m before the end of the route, at which a human-driven car leaves


def make_cars(config: JunctionConfig) -> Cars:
    """Builds the back end that a configuration names."""
    if config.cars == "path":
        return PathCars(config.sim)
    physics = BicyclePhysics if config.cars == "bicycle" else MjxPhysics
    return SteeredCars(physics(config.sim), preset(config.vehicle))


def _own_buffers(state: State) -> State:
    """Copies arrays outside of jit, so that callers may donate them.

    There a function may return its own arguments, or one array in several places. A
    program that donates its argument (`donate_argnums`) would delete or refuse these.
    """
    return jax.tree.map(lambda x: x if isinstance(x, Tracer) else x.copy(), state)
