"""The planner as a policy by name; it needs the extra `planner`."""

from carpark_mj.planning.policy import planner_policy
from carpark_mj.policy.named import POLICIES

POLICIES.register("planner", lambda env: planner_policy(env)[0])
