"""Goal poses that can be relabelled (HER): observations in three parts."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import Layout
from carpark_mj.mdp.rewards import term_weights
from carpark_mj.observations import make_fields
from carpark_mj.observations.fields import Field
from carpark_mj.physics.base import Physics
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.tasks.goal_pose import (
    FEATURES,
    NUM_FEATURES,
    POSE,
    car_features,
    goal_features,
    pose_norm,
)
from carpark_mj.types import State, TimeStep


class GoalParking(ParkingEnv):
    """One agent whose observation ends with its own features and those of its goal.

    The observation is a vector of three parts, see `unpack`: the fields that do not
    reveal the goal, and `FEATURES` of the car and of the goal, free of noise.

    Attributes:
        fields: of the first part.
        goal_fields: of the second and the third part.
    """

    fields: tuple[Field, ...]
    goal_fields = FEATURES

    def __init__(self, config: EnvConfig, physics: Physics | None = None) -> None:
        """Builds the environment; see `ParkingEnv`.

        Raises:
            ValueError: several agents, respawn, a dynamic goal, observations without a
                field that reveals the goal, or a reward that does not follow from poses
                and crashes.
        """
        super().__init__(config, physics)
        config = self.config
        if config.num_agents != 1 or config.episode.respawn or config.goals.dynamic:
            raise ValueError(
                "goal poses need num_agents = 1, episode.respawn = False and "
                "goals.dynamic = False"
            )
        fields = make_fields(config)
        if not any(field.reveals_goal for field in fields):
            raise ValueError(
                "goal poses need an observation whose fields say what reveals the goal "
                f"(Field.reveals_goal): the encoding {config.observation.encoding!r} "
                "has none"
            )
        paid = {name for name, weight in term_weights(config).items() if weight}
        if "pose" not in paid or paid - {"pose", "crash"}:
            raise ValueError(
                "goal poses need a reward of the terms pose and crash alone, which can "
                f"be computed for other goals, not of {sorted(paid)}"
            )
        self.fields = tuple(field for field in fields if not field.reveals_goal)
        keep = [not field.reveals_goal for field in fields]
        self._kept = np.flatnonzero(np.repeat(keep, [field.size for field in fields]))

    @property
    def observation_size(self) -> int:
        """Length of the vector."""
        return len(self._kept) + 2 * NUM_FEATURES

    def unpack(self, observation: jax.Array) -> dict[str, jax.Array]:
        """The parts of vectors (..., observation_size) by Gymnasium's names."""
        own = len(self._kept)
        ends = [own, own + NUM_FEATURES]
        parts = jnp.split(observation, ends, axis=-1)
        names = "observation", "achieved_goal", "desired_goal"
        return dict(zip(names, parts, strict=True))

    def rewards(
        self, achieved: np.ndarray, desired: np.ndarray, crashed: np.ndarray
    ) -> np.ndarray:
        """Rewards (...) of features (..., 6) at a step's end; `crashed` (...) bool."""
        reward = self.config.reward
        parameters = POSE.parameters | reward.parameters("pose")
        # In double precision: sums of one row and of many may round differently.
        norm = pose_norm(np.float64(achieved), np.float64(desired), **parameters)
        paid = -reward.extra["pose"] * norm - reward.crash * crashed
        return paid.astype(np.float32)

    def reset_to_layout(
        self,
        layout: Layout,
        key: jax.Array,
        num_present: jax.Array | None = None,
        options: ResetOptions | None = None,
    ) -> tuple[State, jax.Array]:
        """See `ParkingEnv.reset_to_layout`."""
        state, seen = super().reset_to_layout(layout, key, num_present, options)
        return state, self._vector(state, seen)

    def step(self, state: State, action: jax.Array) -> tuple[State, TimeStep]:
        """See `ParkingEnv.step`."""
        after, timestep = super().step(state, action)
        vector = self._vector(after, timestep.observation)
        return after, dataclasses.replace(timestep, observation=vector)

    def _vector(self, state: State, observation: jax.Array) -> jax.Array:
        own: Any = observation[:, self._kept]
        parts = own, car_features(state.motion), goal_features(state)
        return jnp.concatenate(parts, axis=-1)
