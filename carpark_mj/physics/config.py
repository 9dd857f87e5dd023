"""Settings of the physics: time steps, ground and tyres, and back ends by name.

Back ends of the core are in the modules of the registry `PHYSICS`, each beside its
settings, and loaded when they are looked up; extensions register others.
"""

import abc
import dataclasses
import functools
from typing import TYPE_CHECKING, Annotated, Any, Literal

from carpark_mj.config.checks import (
    Bounds,
    CheckedConfig,
    Positive,
    require_number,
    require_unset,
)
from carpark_mj.extensions import Registry

Surface = Literal["dry", "wet", "ice"]
TyresName = Literal["brush", "contact"]
StepperName = Literal["auto", "unrolled", "mjx"]

CONTACT_SIM_DT = 0.004  # s; beyond it a locked wheel throws the car
BRUSH_SIM_DT = 0.02  # s; bristles and wheels ring from 0.04 s on
MAX_SUBSTEPS = 10_000  # of a control step; reference solutions take 1,000
MAX_DELAY = 2.0  # s, of an actuator
MAX_CREEP = 2.0  # m/s^2
MAX_GAP = 2.0  # m, of automatic braking


@dataclasses.dataclass(frozen=True)
class SimConfig(CheckedConfig):
    """Time steps, ground and actuators of the physics.

    Attributes:
        sim_dt: physics substep [s]; 0.01 for training, 0.005 as a reference. At most
            0.02 with brush tyres; physics without tyres take any.
        ctrl_dt: control period [s], a multiple of `sim_dt`.
        trace_dt: longest time between two collision tests within a control step [s].
        grade_x: slope of the ground along world x, rise over run; 0.05 = 5 % uphill.
        tyres: tyre model: `brush`, or `contact`: MuJoCo's own contacts, for
            cross-checks; they need a `sim_dt` of at most 0.004 s.
        suspension: springs between contact tyres and car; brush tyres always have them.
        stepper: of `mjx` cars: the `unrolled` equations, or `mjx.step`; `auto` takes
            the former where they hold, on brush tyres.
        surface: road surface, which sets the grip, `carpark_mj.vehicle.vehicle`.
        ramp: start and end of a ramp across the lot, along world x [m], and its slope,
            added to `grade_x` between them; it begins and ends over 3 m outside. A
            slope of 0 is no ramp.
        steering_delay: dead time of the steering [s], a multiple of `sim_dt`. By wire
            it is 0.24, and 0.1 of the acceleration (defaults of Autoware's
            `simple_planning_simulator`).
        pedal_delay: dead time of drive and brakes [s], a multiple of `sim_dt`.
        creep: acceleration from rest of an automatic whose engine idles, no pedal
            pressed [m/s^2]; 0 = none, about 0.4 in real cars.
        emergency_brake: gap to people, movers and other agents [m] that automatic
            emergency braking keeps ahead of a car that moves; 0 = none.
        manoeuvre_brake: gap to parked cars and walls [m] at which it brakes; 0 = none.
    """

    sim_dt: Positive = 0.01
    ctrl_dt: Positive = 0.2
    trace_dt: Positive = 0.05
    grade_x: Annotated[float, Bounds(gt=-1.0, lt=1.0)] = 0.0
    tyres: TyresName = "brush"
    suspension: bool = False
    stepper: StepperName = "auto"
    surface: Surface = "dry"
    ramp: Annotated[tuple[float, float, float], Bounds()] = (0.0, 0.0, 0.0)
    steering_delay: Annotated[float, Bounds(ge=0.0, le=MAX_DELAY, unit="s")] = 0.0
    pedal_delay: Annotated[float, Bounds(ge=0.0, le=MAX_DELAY, unit="s")] = 0.0
    creep: Annotated[float, Bounds(ge=0.0, le=MAX_CREEP, unit="m/s^2")] = 0.0
    emergency_brake: Annotated[float, Bounds(ge=0.0, le=MAX_GAP, unit="m")] = 0.0
    manoeuvre_brake: Annotated[float, Bounds(ge=0.0, le=MAX_GAP, unit="m")] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("ctrl_dt", "steering_delay", "pedal_delay"):
            substeps = getattr(self, name) / self.sim_dt
            if abs(substeps - round(substeps)) > 1e-6:
                raise ValueError(
                    f"{name} must be a multiple of sim_dt {self.sim_dt} s, not "
                    f"{getattr(self, name)}"
                )
        if not 1 <= self.num_substeps <= MAX_SUBSTEPS:
            raise ValueError(
                f"sim_dt must be between ctrl_dt / {MAX_SUBSTEPS} and ctrl_dt "
                f"{self.ctrl_dt} s, not {self.sim_dt}"
            )
        step = Bounds(ge=self.sim_dt, unit="s, the sim_dt")
        require_number("trace_dt", self.trace_dt, step)
        if self.tyres == "contact":
            self.require_fine_steps()
        else:
            require_unset(
                self, f"with {self.tyres} tyres, which have one", "suspension"
            )
        if self.stepper == "unrolled" and self.tyres != "brush":
            raise ValueError(
                f"stepper must be 'auto' or 'mjx' with {self.tyres} tyres, not unrolled"
            )
        start, end, grade = self.ramp
        if start > end or abs(self.grade_x + grade) >= 1.0:
            raise ValueError(
                "ramp must be a start, an end not before it and a slope that with "
                f"grade_x lies within (-1, 1), not {self.ramp}"
            )

    def require_fine_steps(self) -> None:
        """Refuses substeps with which the tyres are unstable."""
        most = CONTACT_SIM_DT if self.tyres == "contact" else BRUSH_SIM_DT
        bounds = Bounds(le=most, unit=f"s with {self.tyres} tyres")
        require_number("sim_dt", self.sim_dt, bounds)

    @functools.cached_property
    def has_ramp(self) -> bool:
        """Whether the slope depends on the place."""
        return self.ramp[2] != 0.0

    @property
    def steepest(self) -> float:
        """The largest slope, either way."""
        return max(abs(self.grade_x), abs(self.grade_x + self.ramp[2]))

    @functools.cached_property
    def num_substeps(self) -> int:
        """Physics substeps per control step."""
        return round(self.ctrl_dt / self.sim_dt)

    @functools.cached_property
    def num_traces(self) -> int:
        """Poses recorded per control step, the fewest that respect `trace_dt`."""
        longest = int(self.trace_dt / self.sim_dt + 1e-6)
        stride = max(k for k in range(1, longest + 1) if self.num_substeps % k == 0)
        return self.num_substeps // stride


class PhysicsConfig(CheckedConfig, abc.ABC):
    """A back end: a frozen dataclass of its settings, which builds it.

    The other attributes are its traits, for the task, observations, rewards, planner
    and adapters. The defaults suit a car that is simulated on its own.

    Attributes:
        back_end: its name in `PHYSICS`, a field that is equal in all configs of a
            class; files identify the class by it.
        continuous: number of controls in [-1, 1]; indices come after them, see
            `choices`. Where there are indices only, controls are int32.
        steers: whether it moves cars: the first two controls are steer and pedal, and
            a car needs room to turn. If not, a policy for cars cannot drive it.
        actuated: whether steer and pedal act through the steering, motor and brakes of
            `vehicle.drive`, as the planner expects.
        contacts: whether cars push each other and parked cars. If so, crashes are its
            contacts, `Motion.touched`, and cars that have crashed are simulated on.
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

    @property
    def choices(self) -> tuple[int, ...]:
        """Numbers of choices of the controls that are indices."""
        return ()

    def check(self, config: Any) -> None:
        """Refuses settings of an `EnvConfig` that the back end does not support."""

    @abc.abstractmethod
    def make(self, config: Any, layout: Any, vehicle: Any) -> Any:
        """Builds the back end, a `carpark_mj.physics.base.Physics`.

        Args:
            config: the environment, an `EnvConfig`.
            layout: its `Layout`; None if that is random.
            vehicle: `VehicleParameters` of the car that `config.vehicle` names.
        """

    def turn(self, before: Any, after: Any, ctrl_dt: float) -> Any:
        """How far cars (...) turned their wheels in a step, or themselves [rad].

        From their `Motion` before and after the control period [s].
        """
        return abs(after.steering - before.steering)

    def largest_turn(self, vehicle: Any, ctrl_dt: float) -> Any:
        """Upper bound of `turn` for cars with parameters (...) [rad]."""
        return vehicle.steering_rate * ctrl_dt

    def top_yaw_rate(self, ctrl_dt: float) -> float:
        """How fast it turns cars itself at most [rad/s]; 0 = it does not."""
        return 0.0

    def top_speed(self, vehicle: Any, ctrl_dt: float) -> Any:
        """The highest speed of cars with parameters (...), either way [m/s]."""
        import jax.numpy as jnp

        return jnp.maximum(vehicle.max_speed, vehicle.max_reverse_speed)


PHYSICS: Registry[PhysicsConfig] = Registry(
    "physics", *(f"carpark_mj.physics.{name}" for name in ("bicycle", "mjx", "scene"))
)

# tyro turns a union with dataclasses into subcommands; as a flag physics is its name.
if TYPE_CHECKING:
    PhysicsChoice = PhysicsConfig | str
else:
    PhysicsChoice = str


def physics_config(physics: PhysicsChoice) -> PhysicsConfig:
    """The config of a back end given by name, or as a config."""
    return physics if isinstance(physics, PhysicsConfig) else PHYSICS[physics]
