"""Untrained policies by name: baselines, planners and those of other packages."""

from collections.abc import Callable

from carpark_mj.env import ParkingEnv
from carpark_mj.extensions import Registry
from carpark_mj.policy.acting import AnyPolicy
from carpark_mj.policy.baselines import random_policy, zero_policy

# Functions that make the policy for an environment, or raise `ValueError`.
POLICIES: Registry[Callable[[ParkingEnv], AnyPolicy]] = Registry(
    "policy", "carpark_mj.planning.named"
)

POLICIES.register("zero", lambda env: zero_policy(env.action_spec))
POLICIES.register("random", lambda env: random_policy(env.action_spec))
