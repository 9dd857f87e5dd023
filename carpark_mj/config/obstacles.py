"""Obstacles that move by themselves: the base of their settings, and their names."""

import abc
import enum
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from carpark_mj.config.checks import CheckedConfig
from carpark_mj.extensions import Registry


class ObstacleKind(enum.IntEnum):
    """What an obstacle is: events and metrics tell these apart, by their labels."""

    AGENT = 0
    PARKED_CAR = 1
    WALL = 2  # all that a layout has: pillars and bollards too
    MOVER = 3

    @property
    def label(self) -> str:
        """End of the names of events and metrics."""
        return self.name.lower()


class Mover(CheckedConfig, abc.ABC):
    """Base of moving obstacles that are not cars, a frozen dataclass of settings.

    Agents must avoid them: contacts do not push them.

    Attributes:
        mover: its name in `MOVERS`.
        kind: what its obstacles are.
    """

    mover: str
    kind: ClassVar[ObstacleKind] = ObstacleKind.MOVER

    @abc.abstractmethod
    def init(self, key: Any, layout: Any) -> Any:
        """Its state in a lot that begins, a pytree of arrays.

        Args:
            key: consumed.
            layout: the lot, a `carpark_mj.layouts.Layout`.
        """

    @abc.abstractmethod
    def step(self, key: Any, state: Any, lot: Any, dt: float) -> Any:
        """Its state after a control step, of the same shapes.

        Args:
            key: consumed.
            state: before.
            lot: everything else before, a `carpark_mj.types.State`.
            dt: control period [s].
        """

    @abc.abstractmethod
    def obstacles(self, state: Any) -> Sequence[Any]:
        """Where it is: groups `Boxes` and `Discs` of `carpark_mj.obstacles`.

        Their number is constant; masks mark those that exist. Between two steps
        obstacles move along straight lines; new ones appear at their new places.
        """


MOVERS: Registry[Mover] = Registry("mover")

# As a flag a mover is its name, as a layout is.
if TYPE_CHECKING:
    MoverChoice = Mover | str
else:
    MoverChoice = str


def make_movers(choices: Sequence[MoverChoice]) -> tuple[Mover, ...]:
    """The movers that names stand for; others as given.

    Raises:
        ValueError: an unknown name, or a mover that says that it is an agent.
    """
    movers = tuple(MOVERS[x] if isinstance(x, str) else x for x in choices)
    for mover in movers:
        if mover.kind == ObstacleKind.AGENT:
            raise ValueError(f"the mover {mover.mover!r} must not be of the kind AGENT")
    return movers


def hit_kinds(movers: Sequence[MoverChoice]) -> tuple[ObstacleKind, ...]:
    """Kinds of obstacles in a lot with some movers."""
    always = (ObstacleKind.AGENT, ObstacleKind.PARKED_CAR, ObstacleKind.WALL)
    return tuple(sorted({*always, *(mover.kind for mover in make_movers(movers))}))
