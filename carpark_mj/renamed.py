"""Names of earlier versions: what refuses an unknown name says what became of it."""

import importlib.machinery
import sys
from collections.abc import Callable, Iterable, Sequence
from types import ModuleType
from typing import Any, get_type_hints

# Settings are `CLASS.field`, with their new name in that class; registered parts `KIND
# NAME`; modules and what is in them dotted names. What has a space is a sentence's end,
# and "" is gone.
RENAMED: dict[str, str] = {
    "EnvConfig.grid": "physics",
    "CurriculumConfig.crash_ratio": "conflict_ratio",
    "SpawnConfig.crash_distance": "conflict_distance",
    "SpawnConfig.crash_ratio": "conflict_ratio",
    "RewardConfig.approach": "extra.approach",
    "RewardConfig.smoothness": "extra.smoothness",
    "RewardConfig.smoothness_by_speed": "extra.smoothness.by_speed",
    "RewardConfig.reverse": "extra.reverse",
    "EvaluateConfig.span": "horizon",
    "RewardConfig.reeds_shepp": "reeds_shepp_reach",
    "ShareConfig.order": "priority",
    **dict.fromkeys(
        (
            "CurriculumConfig.discount_from",
            "CurriculumConfig.discount_until",
            "GoalRewards.lost_goal",
            "GoalRewards.taken_goal",
            "PPOConfig.checkpoint_updates",
            "PPOConfig.hitbox_scale",
            "PPOConfig.hitbox_steps",
            "RewardConfig.alignment_range",
            "RewardConfig.closeness_range",
            "RewardConfig.final_heading",
            "RewardConfig.final_speed",
            "RewardConfig.timeout",
            "RewardConfig.wrong_way",
            "SimConfig.grade_y",
        ),
        "",
    ),
    "ContinuousObservation.view": "a setting of the encoding 'tanner'",
    "ShareConfig.goal_headings": "a setting of the encoding 'tanner'",
    "LayoutsConfig.held_out": "the function carpark_mj.suite.levels.write",
    "SceneConfig.junction": "carpark_mj study junction_scene",
    "layout compact": "square_compact",
    "layout tanner": "square",
    "carpark_mj.config.ContinuousObservation": (
        "carpark_mj.observations.ContinuousObservation"
    ),
    "carpark_mj.config.register_rule": "carpark_mj.config.PARKED_RULES",
    "carpark_mj.config.reward_preset": "carpark_mj.config.REWARDS",
    "carpark_mj.evaluation.rollout": "carpark_mj.evaluation.evaluator",
    "carpark_mj.layouts.COMPACT": "carpark_mj.layouts.SQUARE_COMPACT",
    "carpark_mj.layouts.TANNER": "carpark_mj.layouts.SQUARE",
    "carpark_mj.layouts.generate": "the method generate of a layout's config",
    "carpark_mj.rendering.rollout": "carpark_mj.rendering.recording",
    "carpark_mj.wrappers.joint": "carpark_mj.tasks.joint",
    **{
        f"carpark_mj.{old}": f"carpark_mj.{new}"
        for old, new in {
            "config.sensors": "config.observations",
            "config.units": "config.terminations",
            "layouts.lanes": "layouts.routes",
            "mdp.chosen_goals": "mdp.dynamic_goals",
            "mdp.goal_rewards": "mdp.rewards",
            "mdp.metrics.collision_time": "mdp.metrics.safety",
            "mdp.metrics.driving": "mdp.metrics.tallies",
            "mdp.metrics.goals": "mdp.metrics.tallies",
            "mdp.spawning.driving_out": "mdp.fixed_goals",
            "mdp.spawning.room": "mdp.spawning.placing",
            "mdp.wrong_way": "mdp.progress",
            "observations.lane": "observations.ego",
            "observations.localised": "observations.fields",
            "physics.make": "physics.base",
            "vehicle.load": "vehicle.conditions",
            "vehicle.surfaces": "vehicle.conditions",
            "vehicle.tipping": "fleet.randomization",
        }.items()
    },
}


def _sentence(old: str, new: str) -> str:
    return f"{old} is now {new}" if new else f"{old} was removed: nothing used it"


def refuse_part(kind: str, name: str) -> None:
    """Refuses the former name of a registered part.

    Raises:
        ValueError: with its new name.
    """
    if (old := f"{kind} {name}") in RENAMED:
        raise ValueError(_sentence(f"the {kind} {name!r}", repr(RENAMED[old])))


def refuse_settings(cls: type, names: Iterable[str], of: str = "") -> None:
    """Refuses former settings of a dataclass.

    Args:
        cls: the dataclass; those of its bases count.
        names: what is given, among them settings that it has.
        of: what to call them by; empty = the name of the class and a dot.

    Raises:
        ValueError: with the new name of one.
    """
    known = getattr(cls, "__dataclass_fields__", {})
    for name in names:
        for base in cls.__mro__ if name not in known else ():
            if (old := f"{base.__name__}.{name}") in RENAMED:
                start, new = of or f"{base.__name__}.", RENAMED[old]
                former, whole = start + name, not new or " " in new
                new = new if whole else start + new
                if of.startswith("--"):  # as the help writes flags
                    former = former.replace("_", "-")
                    new = new if whole else new.replace("_", "-")
                raise ValueError(_sentence(former, new))


def refuse_flags(config: Any, arguments: Sequence[str]) -> None:
    """Refuses former flags.

    Args:
        config: a dataclass whose fields are flags, or its class.
        arguments: of the command line.

    Raises:
        ValueError: with the flag's new name.
    """
    for word in arguments:
        if not word.startswith("--"):
            continue
        part, path = config, word[2:].partition("=")[0].split(".")
        for depth, name in enumerate(path):
            field = name.replace("-", "_")
            start = "--" + "".join(f"{outer}." for outer in path[:depth])
            if isinstance(part, type):
                refuse_settings(part, [field], start)
                part = get_type_hints(part).get(field)
            else:
                refuse_settings(type(part), [field], start)
                part = getattr(part, field, None)


class OldNames:
    """Base of dataclasses that refuse their former settings by name."""

    def __new__(cls, *_: Any, **settings: Any) -> Any:
        """Refuses former settings; the rest is as in any class."""
        refuse_settings(cls, settings)
        return super().__new__(cls)


def old_names(module: str) -> Callable[[str], Any]:
    """The `__getattr__` of a module from which names have moved.

    It raises an ImportError even where an attribute is asked for, as an AttributeError
    would not be shown where it is imported.
    """

    def getattribute(name: str) -> Any:
        if (old := f"{module}.{name}") in RENAMED:
            raise ImportError(_sentence(old, RENAMED[old]), name=module)
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return getattribute


class _OldModules:
    """The last finder of modules, for modules that no other finder has found."""

    def find_spec(
        self, name: str, path: Any = None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        del path, target
        if name in RENAMED:
            # A ModuleNotFoundError would be lost in `from PACKAGE import MODULE`.
            raise ImportError(_sentence(name, RENAMED[name]), name=name)
        return None


def name_old_modules() -> None:
    """Makes imports of moved modules name their new location."""
    sys.meta_path.append(_OldModules())
