"""Giving way: what agents know of each other, and when they should give up a goal."""

import dataclasses
from typing import Annotated, Literal, get_args

from carpark_mj.config.checks import Bounds, CheckedConfig
from carpark_mj.config.insertion import data

Scheme = Literal["L,L,S", "L,L,A", "G,L,S", "G,L,A", "G,G,S", "G,G,A"]
ContextName = Literal[
    "local_same",
    "local_any",
    "global_same",
    "global_any",
    "untracked_same",
    "untracked_any",
    "untracked_other",
    "only_untracked_same",
    "only_untracked_any",
    "global_same_not_local_any",
]

_ENFORCED: dict[str, ContextName] = {
    "L,S": "local_same",
    "L,A": "local_any",
    "G,S": "global_same",
    "G,A": "global_any",
}


@dataclasses.dataclass(frozen=True)
class GivingWayConfig(CheckedConfig):
    """Asks agents to give up goals that another agent is nearer to.

    A scheme (a, b, c) of Tanner 2022 is written "a,b,c". With a = G the
    agents see global information about the bays they track, with L they do not. (b, c)
    is the enforced context: a goal is bad if another agent is nearer to it that is
    tracked (b = L) or anywhere (b = G), and has the same goal (c = S) or any (c = A).

    Attributes:
        scheme: "a,b,c", one of the six of the study: "L,L,S", "L,L,A", "G,L,S",
            "G,L,A", "G,G,S", "G,G,A"; None = no context is enforced. Needs dynamic
            goals.
        bad_goal: reward for keeping a bad goal, in place of `continue_goal`; at most 0.
            The study sweeps 0 to -0.2.
    """

    scheme: Scheme | None = None
    bad_goal: Annotated[float, Bounds(le=0.0)] = data(0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scheme is None and self.bad_goal:
            raise ValueError(
                f"bad_goal {self.bad_goal} needs a scheme, one of "
                f"{sorted(get_args(Scheme))}"
            )

    @property
    def global_information(self) -> bool:
        """Whether the scheme shows the agents global information."""
        return self.scheme is not None and self.scheme.startswith("G")

    @property
    def context(self) -> ContextName | None:
        """The context in which keeping the goal is bad; None if none is enforced."""
        return None if self.scheme is None else _ENFORCED[self.scheme[2:]]
