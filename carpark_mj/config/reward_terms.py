"""Reward terms by name: how one is declared, and which of its numbers are data."""

import dataclasses
import inspect
import math
from collections.abc import Callable, Container, Mapping
from typing import Any

from carpark_mj.config.checks import CheckedConfig, is_finite
from carpark_mj.extensions import Registry


@dataclasses.dataclass(frozen=True)
class RewardTerm(CheckedConfig):
    """A term of the reward; its weight is a setting of `RewardConfig`.

    Attributes:
        value: the term without weight and sign: a function of an `EnvConfig` and a
            `Transition` that returns (num_agents,), in JAX. Its other arguments are
            parameters, numbers with defaults. Where the weight is known to be 0 it is
            not called.
        sign: 1 = reward, -1 = penalty.
        per_step: divide the weight by `EpisodeConfig.max_steps`, so that a full episode
            adds up to it.
        fixed: parameters that decide what is computed. All other numbers of a term may
            be traced, and differ between runs side by side.
        most: largest weight.
    """

    value: Callable[..., Any]
    sign: float = 1.0
    per_step: bool = False
    fixed: tuple[str, ...] = ()
    most: float = math.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sign not in (1, -1):
            raise ValueError(f"sign must be 1 or -1, not {self.sign}")
        for name, default in self.parameters.items():
            if not is_finite(default):
                raise ValueError(
                    f"parameter {name} of a reward term must have a default, a number"
                )
        if unknown := sorted({*self.fixed} - {*self.parameters}):
            raise ValueError(f"fixed names no parameters of the term: {unknown}")

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters' defaults by name."""
        arguments = list(inspect.signature(self.value).parameters.values())[2:]
        return {argument.name: argument.default for argument in arguments}

    @property
    def meaning(self) -> str:
        """The first line of the function's docstring."""
        return (inspect.getdoc(self.value) or "").partition("\n")[0]


# Terms beyond those of `carpark_mj.mdp.rewards`, for `RewardConfig.extra`.
REWARD_TERMS: Registry[RewardTerm] = Registry(
    "reward term",
    "carpark_mj.tasks.goal_pose",
    "carpark_mj.mdp.progress",
    "carpark_mj.mdp.yielding",
    "carpark_mj.mdp.people",
)


def term_settings(name: str) -> dict[str, float | None]:
    """Settings of a registered term by their names in `RewardConfig.extra`.

    Returns:
        Defaults; the weight, called as the term, has none.

    Raises:
        ValueError: there is no such term.
    """
    parameters = REWARD_TERMS[name].parameters.items()
    return {name: None, **{f"{name}.{key}": default for key, default in parameters}}


class ExtraTerms(dict[str, float]):
    """Settings of registered terms by name, in the order in which terms are added.

    It is hashable, as configs are, and not to be changed.
    """

    def __eq__(self, other: object) -> bool:
        return isinstance(other, dict) and list(self.items()) == list(other.items())

    def __hash__(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return hash(tuple(self.items()))


def check_extra(extra: Mapping[str, float], taken: Container[str]) -> None:
    """Refuses settings of no registered term.

    Args:
        extra: settings by name.
        taken: names that terms of the library have.

    Raises:
        ValueError: naming the setting and what is allowed.
    """
    for key, value in extra.items():
        name, _, parameter = key.partition(".")
        if name in taken:
            raise ValueError(f"extra cannot have {name!r}: the library has such a term")
        if key not in (known := term_settings(name)):
            raise ValueError(
                f"reward term {name!r} has no parameter {parameter!r}: its settings "
                f"are {', '.join(known)}"
            )
        if not is_finite(value) or (key == name and value < 0.0):
            least = "at least 0.0" if key == name else "finite"
            raise ValueError(f"{key} must be {least}, not {value!r}")
        if key == name and value > (most := REWARD_TERMS[name].most):
            raise ValueError(f"{key} must be at most {most}, not {value!r}")
        if name not in extra:
            raise ValueError(f"{key} needs {name}, the weight of the term")


def is_fixed(key: str) -> bool:
    """Whether a setting of a term decides what is computed."""
    name, _, parameter = key.partition(".")
    return parameter in REWARD_TERMS[name].fixed
