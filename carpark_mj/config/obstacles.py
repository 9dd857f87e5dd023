"""Obstacles that move by themselves: the base of their settings, and their names."""

import abc
import dataclasses
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
    PERSON = 4
    DRIVER = 5

    @property
    def label(self) -> str:
        """End of the names of events and metrics."""
        return self.name.lower()


class Mover(CheckedConfig, abc.ABC):
    """Base of obstacles that move by themselves, a frozen dataclass of settings.

    Agents must avoid them: contacts do not push them. They push and stop cars in
    physics whose world has them, `scene`.

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

    def begin(self, key: Any, layout: Any, others: Sequence[Any]) -> Any:
        """Its state in a lot that begins, clear of what stands there already.

        By default that of `init`, wherever the others are.

        Args:
            key: consumed.
            layout: the lot.
            others: groups of obstacles: parked cars, walls, and the movers before it.
        """
        del others
        return self.init(key, layout)

    @abc.abstractmethod
    def step(self, key: Any, state: Any, lot: Any, dt: float) -> Any:
        """Its state after a control step, of the same shapes.

        Args:
            key: consumed.
            state: before.
            lot: everything else, a `carpark_mj.types.State` before the step. Its movers
                are the others: those before it in the lot's list have already moved.
            dt: control period [s].
        """

    @abc.abstractmethod
    def obstacles(self, state: Any) -> Sequence[Any]:
        """Where it is: groups `Boxes` and `Discs` of `carpark_mj.obstacles`.

        Their number is constant; masks mark those that exist. Between two steps
        obstacles move along straight lines; new ones appear at their new places.
        """


MOVERS: Registry[Mover] = Registry("mover", "carpark_mj.movers")

# As a flag a mover is its name, as a layout is.
if TYPE_CHECKING:
    MoverChoice = Mover | str
else:
    MoverChoice = str


def make_movers(choices: Sequence[MoverChoice]) -> tuple[Mover, ...]:
    """The movers that names stand for; others as given.

    A name may bring settings, as in `pedestrians:number=20,speed=0.8..1.6`.

    Raises:
        ValueError: an unknown name or setting, or a mover that says that it is an
            agent.
    """
    movers = tuple(_named(x) if isinstance(x, str) else x for x in choices)
    for mover in movers:
        if mover.kind == ObstacleKind.AGENT:
            raise ValueError(f"the mover {mover.mover!r} must not be of the kind AGENT")
    return movers


def _named(choice: str) -> Mover:
    """The mover of a name, with the settings that follow it."""
    name, colon, words = choice.partition(":")
    mover: Any = MOVERS[name]
    values: dict[str, str | float | tuple[float, ...]] = {}
    fields = dataclasses.fields(mover)
    known = [field.name for field in fields if field.name != "mover"]
    for word in words.split(",") if colon else ():
        setting, _, value = word.partition("=")
        if setting not in known:
            raise ValueError(
                f"the mover {name!r} has no setting {setting!r}: its settings are "
                f"{', '.join(known)}"
            )
        if isinstance(getattr(mover, setting), str):
            values[setting] = value
            continue
        numbers = [_number(setting, part) for part in value.split("..")]
        values[setting] = numbers[0] if len(numbers) == 1 else tuple(numbers)
    return dataclasses.replace(mover, **values)


def _number(setting: str, text: str) -> float:
    """A number of a setting; a whole one if it is written so."""
    try:
        return int(text) if text.lstrip("-").isdigit() else float(text)
    except ValueError:
        raise ValueError(
            f"{setting} must be a number, or two with .. between them, not {text!r}"
        ) from None


def hit_kinds(movers: Sequence[MoverChoice]) -> tuple[ObstacleKind, ...]:
    """Kinds of obstacles in a lot with some movers."""
    always = (ObstacleKind.AGENT, ObstacleKind.PARKED_CAR, ObstacleKind.WALL)
    return tuple(sorted({*always, *(mover.kind for mover in make_movers(movers))}))
