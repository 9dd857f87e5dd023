"""The catalogue of metrics: meanings, units and aggregation over episodes.

It defines the library's metrics, which `docs/metrics.md` lists; others are
registered (`carpark_mj.mdp.metrics`). An evaluation has a column for each in the
table of episodes, and one or several aggregates.
"""

from carpark_mj.mdp.collisions import HORIZON, RANGE
from carpark_mj.mdp.metrics import METRICS, Metric, Pool

# How episodes add up.
POOLS: dict[Pool, str] = {
    "rate": "share of the episodes, its 95 % interval, and their count",
    "mean": "mean over episodes",
    "parked": "mean over parked episodes",
    "steps": "sum over all steps of all episodes / number or metres of these steps",
    "episodes": "mean over the episodes that have such steps",
    "least": "median, 5 % quantile and minimum over episodes",
    "most": "median, 95 % quantile and maximum over episodes",
}
# A crash this early is attributed to the spawn, not to the policy: the study's step
# count is below 2 then.
START_STEPS = 1


def _rate(name: str, meaning: str) -> Metric:
    return Metric(name, "", meaning, "rate")


def _per_step(name: str, unit: str, meaning: str) -> Metric:
    return Metric(name, unit, meaning, "steps", (f"{name}_sum", "length"))


def _share(name: str, of: str, above: str, below: str) -> Metric:
    return Metric(name, "", f"share of the steps {of}", "episodes", (above, below))


def _goals(name: str, what: str) -> Metric:
    return Metric(name, "", f"goals {what}", "mean")


def _clearance(kind: str, what: str) -> Metric:
    meaning = f"smallest gap of footprints to {what}; capped at {RANGE:g} m"
    return Metric(f"min_clearance{kind}", "m", meaning, "least")


def _collision_time(kind: str, what: str) -> Metric:
    meaning = f"shortest time to collision with {what}; {HORIZON:g} = never sooner"
    return Metric(f"min_collision_time{kind}", "s", meaning, "least")


_WHAT = {
    "": "anything",
    "_agent": "another agent",
    "_parked_car": "a parked car",
    "_wall": "a wall or disc",
    "_mover": "a mover, if any",
    "_person": "a person, if any",
    "_driver": "another driver, if any",
}
OUTCOME = (
    _rate("parked", "parked under the rule in force"),
    _rate("crashed", "hit an obstacle"),
    _rate("timed_out", "neither within `max_steps`"),
    _rate("diverged", "non-finite physics, or the car on its side"),
    _rate("hit_agent", "crashed into an agent; both count"),
    _rate("hit_parked_car", "crashed into a parked car"),
    _rate("hit_wall", "crashed into a wall or disc"),
    _rate("hit_mover", "crashed into a mover, if any"),
    _rate("hit_person", "crashed into a person, if any"),
    _rate("hit_driver", "crashed into another driver, if any"),
    _rate("crashed_at_start", "crashed in the first step"),
    Metric("episode_return", "", "sum of rewards", "mean"),
    Metric("length", "steps", "control steps", "mean"),
    Metric("time_to_park", "s", "duration of a parked episode", "parked"),
    Metric("path", "m", "distance driven in either direction", "parked"),
    Metric("gear_changes", "", "changes of the direction of travel", "parked"),
    Metric("invalid_actions", "", "steps with NaN or numbers out of range", "mean"),
    Metric("wrong_way", "m", "distance driven against the lanes, if any", "mean"),
    Metric(
        "wrong_way_share",
        "",
        "share of the distance driven against the lanes, if any",
        "steps",
        ("wrong_way", "path"),
    ),
    Metric("final_distance", "m", "from centre to the goal's centre", "parked"),
    Metric("final_heading", "rad", "to the goal's axis, either way round", "parked"),
    Metric("final_speed", "m/s", "absolute speed at the end", "parked"),
)
DRIVING = (
    _per_step("speed", "m/s", "mean absolute speed"),
    _per_step("yaw_rate", "rad/s", "mean absolute yaw rate"),
    _per_step("steering_rate", "rad/s", "mean absolute rate of the road-wheel angle"),
    Metric(
        "nearest_car",
        "m",
        "mean distance of centres to the nearest car, agent or parked",
        "steps",
        ("nearest_car_sum", "nearest_car_steps"),
    ),
    _share(
        "towards_goal",
        "with a goal that led nearer to it",
        "towards_goal_steps",
        "goal_steps",
    ),
)
SAFETY = (
    *(_clearance(kind, what) for kind, what in _WHAT.items()),
    *(_collision_time(kind, what) for kind, what in _WHAT.items()),
    _per_step("acceleration", "m/s²", "mean length of the acceleration"),
    Metric("peak_acceleration", "m/s²", "largest length of the acceleration", "most"),
    _per_step("jerk", "m/s³", "mean length of the jerk"),
    Metric("peak_jerk", "m/s³", "largest length of the jerk", "most"),
)
_GAVE_WAY = {
    "local_same": "a tracked agent nearer to the goal has it too",
    "local_any": "a tracked agent is nearer to the goal",
    "global_same": "an agent nearer to the goal has it too",
    "global_any": "an agent is nearer to the goal",
    "untracked_same": "an untracked agent nearer to the goal has it too",
    "untracked_any": "an untracked agent is nearer to the goal",
    "untracked_other": "an untracked agent nearer to the goal does not have it",
    "only_untracked_same": "an untracked agent nearer to the goal has it too, and no "
    "tracked one does",
    "only_untracked_any": "an untracked agent is nearer to the goal, and no tracked "
    "one is",
    "global_same_not_local_any": "an agent nearer to the goal has it too, and no "
    "tracked agent is nearer",
}
GOALS = (
    _share("explore_share", "without a goal", "explored_steps", "length"),
    _share(
        "towards_bay",
        "without a goal that led nearer to any tracked bay",
        "towards_bay_steps",
        "explored_steps",
    ),
    _goals("stop_explore", "taken"),
    _goals("change_goal", "changed for others"),
    _goals("stop_goal", "given up to explore"),
    _goals("lost_untracked", "lost because others were nearer"),
    _goals("lost_taken", "lost because another agent parked there"),
    *(
        Metric(
            f"conformity_{name}",
            "",
            f"of the steps in which {when}: share in which the goal was given up",
            "steps",
            (f"gave_way_{name}", f"met_{name}"),
        )
        for name, when in _GAVE_WAY.items()
    ),
)
_LIBRARY = OUTCOME + DRIVING + SAFETY + GOALS


def metrics() -> tuple[Metric, ...]:
    """The library's metrics, and after them the registered ones by name."""
    return _LIBRARY + tuple(METRICS.values())
