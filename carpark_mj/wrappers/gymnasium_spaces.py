"""Spaces of Gymnasium environments with one agent each."""

from typing import Any

from gymnasium import spaces

from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.wrappers import spaces as agent_spaces
from carpark_mj.wrappers.goal import GoalParking


def action_space(spec: ActionSpec) -> spaces.Space[Any]:
    """Numbers in [-1, 1], or indices.

    Raises:
        ValueError: actions have both numbers and indices.
    """
    if spec.continuous and spec.choices:
        raise ValueError(
            "an array holds numbers or indices: goals.dynamic must be False except "
            "with physics whose controls are indices"
        )
    return agent_spaces.action_space(spec)


def observation_space(env: ParkingEnv) -> spaces.Space[Any]:
    """Space of the observation: a dictionary for goal environments and pictures."""
    if not isinstance(env, GoalParking):
        return agent_spaces.observation_space(env.config)
    own, goal = (
        agent_spaces.vector_space(env.config, fields)
        for fields in (env.fields, env.goal_fields)
    )
    return spaces.Dict(observation=own, achieved_goal=goal, desired_goal=goal)
