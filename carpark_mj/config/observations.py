"""What agents observe: the base of the encoders, and settings that several share."""

import abc
import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from carpark_mj.config.checks import (
    Bounds,
    CheckedConfig,
    Count,
    Natural,
    NonNegative,
    Positive,
)
from carpark_mj.extensions import Registry


@dataclasses.dataclass(frozen=True)
class Tracked:
    """How many of the nearest cars an encoder tracks.

    Attributes:
        agents: other agents.
        parked_cars: parked cars.
        cars: agents and parked cars in one list.
    """

    agents: int = 0
    parked_cars: int = 0
    cars: int = 0


class ObservationConfig(CheckedConfig, abc.ABC):
    """An encoder of observations: a frozen dataclass of its settings.

    It lists the fields of the vector and fills them. The properties and methods below
    tell the environment what else the encoder needs; a class overrides them where the
    defaults are wrong.

    Attributes:
        encoding: its name in `ENCODERS`, the default of each class and never another.
    """

    encoding: str

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.encoding != type(self).encoding:
            raise ValueError(
                f"encoding of {type(self).__name__} must be "
                f"{type(self).encoding!r}, not {self.encoding!r}"
            )

    @abc.abstractmethod
    def fields(self, env: Any) -> Sequence[Any]:
        """The fields of the vector in order, `carpark_mj.observations.Field`.

        Args:
            env: the `EnvConfig`.
        """

    @abc.abstractmethod
    def values(self, env: Any, state: Any) -> Mapping[str, Any]:
        """Values (num_agents, field.size) of all fields by name.

        Args:
            env: the `EnvConfig`.
            state: of the lot, a `carpark_mj.types.State`;
                `observations.sensors.observed` gives the measured poses of cars.
        """

    def check(self, env: Any) -> None:
        """Refuses environments that the encoder does not support.

        Args:
            env: the `EnvConfig`.

        Raises:
            ValueError: naming the setting and what it needs.
        """

    @property
    def tracked(self) -> Tracked:
        """How many cars are tracked at most."""
        return Tracked()

    @property
    def circles(self) -> tuple[float, ...]:
        """Diameters of the circles about the car that count objects [m]."""
        return ()

    @property
    def sees_own_car(self) -> bool:
        """Whether agents with different cars can tell which they drive."""
        return False

    @property
    def sees_routes(self) -> bool:
        """Whether it reads `State.routes`."""
        return False

    @property
    def sees_everywhere(self) -> bool:
        """Whether it tells how near all agents are to bays: global information."""
        return False

    def tracks_agents(self, state: Any) -> Any:
        """Whether agents track each other, (num_agents, num_agents); None = none."""
        del state

    def tracks_parked_cars(self, state: Any) -> Any:
        """Whether agents track cars, (num_agents, num_parked_cars); None = none."""
        del state

    def bays_in_view(self, state: Any) -> Any:
        """Bays (num_agents, bays) that agents can track; None = always all."""
        del state

    def init_memory(self, env: Any) -> Any:
        """What agents remember when an episode begins; None = nothing.

        Returns:
            A pytree of arrays (num_agents, ...), `State.memory`.
        """
        del env

    def remember(self, state: Any) -> Any:
        """`State.memory` once the state belongs to the past."""
        return state.memory


ENCODERS: Registry[type[ObservationConfig]] = Registry(
    "observation encoding",
    "carpark_mj.observations.continuous",
    "carpark_mj.cameras.encoder",
)


@dataclasses.dataclass(frozen=True)
class RingConfig(CheckedConfig):
    """Circles about the car that count the objects they touch; none by default.

    Attributes:
        diameters: diameters of the circles [m].
        cap: largest count a ring reports.
        cars: also count parked cars and other agents, not only walls and discs.
        history: number of past counts of every ring that are observed (n_h); they are
            0 at the start of an episode.
    """

    diameters: Annotated[tuple[float, ...], Bounds(gt=0.0)] = ()
    cap: Count = 2
    cars: bool = False
    history: Natural = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if len({f"{d:g}" for d in self.diameters}) < len(self.diameters):
            # Fields are named by the diameters.
            raise ValueError(f"ring diameters must be different, not {self.diameters}")
        if self.history and not self.diameters:
            raise ValueError(f"ring history {self.history} needs ring diameters")


@dataclasses.dataclass(frozen=True)
class ShareConfig(CheckedConfig):
    """What agents observe of the other agents they track, in addition to their poses.

    Attributes:
        speeds: observe the speeds of tracked agents.
        goals: observe the goals of tracked agents: positions of fixed goals, and which
            of the observer's tracked bays a dynamic goal is.
        steering: observe the steering of tracked agents.
        priority: observe which tracked agents have priority, those that come first in
            the lot, so that two agents of one policy that meet can act differently.
    """

    speeds: bool = True
    goals: bool = True
    steering: bool = False
    priority: bool = False


@dataclasses.dataclass(frozen=True)
class RayConfig(CheckedConfig):
    """Bearings along which the free distance is observed; none by default.

    Attributes:
        count: number of rays, evenly spaced about the car from straight ahead; 0 =
            none. Each measures the distance from the car's outline to the nearest wall,
            disc, parked car or agent.
        reach: longest distance measured [m].
        near: distance [m] up to which the free distance is observed a second time, in
            units of this distance, so that centimetres are visible; at most `reach`,
            0 = not observed twice.
    """

    count: Natural = 0
    reach: Positive = 10.0
    near: NonNegative = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.near > self.reach:
            raise ValueError(
                f"near must be at most the reach {self.reach}, not {self.near}"
            )


@dataclasses.dataclass(frozen=True)
class UltrasoundConfig(CheckedConfig):
    """Twelve ultrasonic sensors around the car; off by default.

    Attributes:
        on: observe them.
        reach: longest distance measured [m].
        dead_zone: shortest distance measured [m]; what is nearer reads as this.
        cone: angle of a sensor's cone [rad].
        noise: standard deviation of the white noise [m].
    """

    on: bool = False
    reach: Positive = 5.0
    dead_zone: NonNegative = 0.15
    cone: Annotated[float, Bounds(gt=0.0, lt=math.pi, unit="rad")] = math.radians(60.0)
    noise: NonNegative = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dead_zone >= self.reach:
            raise ValueError(
                f"dead_zone must be less than the reach {self.reach} m, not "
                f"{self.dead_zone}"
            )


@dataclasses.dataclass(frozen=True)
class SensorConfig(CheckedConfig):
    """Errors of what agents observe of the cars' motion; none by default.

    Attributes:
        position_noise: standard deviation of the white noise on x and y [m].
        heading_noise: standard deviation of the white noise on the yaw [rad].
        speed_noise: standard deviation of the white noise on the velocity, forward and
            left [m/s].
        delay_min: shortest delay of a car's measurements [control steps].
        delay_max: longest delay [control steps]; the delay is drawn at every spawn.
        odometry_scale: standard deviation, over episodes, of the relative error of the
            distance that the wheels measure [m/m]. Where this or one of the next two
            is not 0, a car knows its pose by dead reckoning from its start.
        odometry_veer: the same of the heading per distance [rad/m], positive left.
        odometry_turn: the same of the heading per turn [rad/rad].
    """

    position_noise: NonNegative = 0.0
    heading_noise: NonNegative = 0.0
    speed_noise: NonNegative = 0.0
    delay_min: Natural = 0
    delay_max: Natural = 0
    odometry_scale: NonNegative = 0.0
    odometry_veer: NonNegative = 0.0
    odometry_turn: NonNegative = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.delay_max < self.delay_min:
            raise ValueError(
                f"delay_max must be at least delay_min {self.delay_min}, not "
                f"{self.delay_max}"
            )

    @property
    def is_on(self) -> bool:
        """Whether observations differ from the true motion."""
        return self != SensorConfig()

    @property
    def dead_reckons(self) -> bool:
        """Whether cars know their poses by odometry only."""
        return bool(self.odometry_scale or self.odometry_veer or self.odometry_turn)
