"""Physics back ends by name, and their traits.

The core's own are registered by `carpark_mj.physics.back_ends`, others by extensions.
"""

import abc
import dataclasses
from typing import TYPE_CHECKING, Any

from carpark_mj.config.checks import CheckedConfig
from carpark_mj.extensions import Registry


class PhysicsConfig(CheckedConfig, abc.ABC):
    """A back end: a frozen dataclass of its settings, which builds it.

    The other attributes are its traits, for the task, observations, rewards, planner
    and adapters. The defaults are those of a car that is simulated on its own.

    Attributes:
        back_end: its name in `PHYSICS`, a field that is the same in all configs of a
            class; files tell the classes by it.
        continuous: number of controls in [-1, 1]; indices come after them, see
            `choices`. Where there are indices only, controls are int32.
        steers: whether it moves cars: the first two controls are steer and pedal, and
            a car needs room to turn. If not, a policy for cars cannot drive it.
        actuated: whether steer and pedal act through the steering, motor and brakes of
            `vehicle.drive`, as the planner expects.
        contacts: whether cars push each other and parked cars. If so, crashes are its
            contacts, `Motion.touched`, and a car that has crashed goes on being
            simulated.
        randomized: whether parameters that `RandomizationConfig` draws have an effect.
        keeps_ranges: whether cars are as slow as in a car park, so that observations
            keep to their ranges where walls surround the lot.
    """

    back_end: str
    continuous: int = 2
    steers: bool = True
    actuated: bool = True
    contacts: bool = False
    randomized: bool = True
    keeps_ranges: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        names = [field.name for field in dataclasses.fields(self)]  # pyright: ignore
        if "back_end" not in names:
            raise ValueError(
                f"{type(self).__name__} lacks the field back_end, its name in PHYSICS"
            )

    @property
    def choices(self) -> tuple[int, ...]:
        """Numbers of choices of the controls that are indices."""
        return ()

    def check(self, config: Any) -> None:
        """Refuses settings of an `EnvConfig` that the back end does not support.

        Raises:
            ValueError: naming the setting and what is allowed.
        """
        del config

    @abc.abstractmethod
    def make(self, config: Any, layout: Any, vehicle: Any) -> Any:
        """Builds the back end, a `carpark_mj.physics.base.Physics`.

        Args:
            config: the environment, an `EnvConfig`.
            layout: its `Layout`; None if that is random.
            vehicle: `VehicleParameters` of the car that `config.vehicle` names.

        Raises:
            ValueError: the back end does not support other settings.
        """

    def turn(self, before: Any, after: Any, ctrl_dt: float) -> Any:
        """How far cars (...) turned their wheels in a step, or themselves [rad].

        Args:
            before: their `Motion` at the start.
            after: at the end.
            ctrl_dt: control period [s].
        """
        del ctrl_dt
        return abs(after.steering - before.steering)

    def largest_turn(self, vehicle: Any, ctrl_dt: float) -> Any:
        """Upper bound of `turn` for cars with parameters (...) [rad]."""
        return vehicle.steering_rate * ctrl_dt

    def top_yaw_rate(self, ctrl_dt: float) -> float:
        """How fast it turns cars itself at most [rad/s]; 0 = it does not."""
        del ctrl_dt
        return 0.0

    def top_speed(self, vehicle: Any, ctrl_dt: float) -> Any:
        """The highest speed of cars with parameters (...), either way [m/s]."""
        import jax.numpy as jnp

        del ctrl_dt
        return jnp.maximum(vehicle.max_speed, vehicle.max_reverse_speed)


PHYSICS: Registry[PhysicsConfig] = Registry("physics", "carpark_mj.physics.back_ends")

# tyro turns a union with dataclasses into subcommands; as a flag physics is its name.
if TYPE_CHECKING:
    PhysicsChoice = PhysicsConfig | str
else:
    PhysicsChoice = str


def physics_config(physics: PhysicsChoice) -> PhysicsConfig:
    """The config of a back end given by name, or as a config.

    Raises:
        ValueError: unknown name.
        TypeError: the value is not a back end's config.
    """
    found = physics if isinstance(physics, PhysicsConfig) else PHYSICS[physics]
    if not isinstance(found, PhysicsConfig):  # pyright: ignore
        raise TypeError(f"physics {physics!r} must be a PhysicsConfig, not {found!r}")
    return found
