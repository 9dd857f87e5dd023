"""A car as an FMU (FMI 3.0, co-simulation), for Simulink and other tools.

    pip install -e . pythonfmu3
    pythonfmu3 build -f examples/fmu/car.py     # writes Car.fmu

The tool that imports it needs this Python environment. Inputs are those of an agent;
the equations are those of `mjx` physics, tyres included, at substeps of 10 ms. A
communication step is a multiple of 20 ms.
"""

from typing import Any

import jax
import jax.numpy as jnp
from pythonfmu3 import Boolean, Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability
from pythonfmu3 import String as Text

from carpark_mj import EnvConfig, ParkingEnv
from carpark_mj.config import SimConfig

PERIOD = 0.02  # s
OUTPUTS = {
    "x": "m, of the footprint's centre, world frame",
    "y": "m",
    "yaw": "rad, counter-clockwise from x",
    "speed": "m/s, forwards positive",
    "lateral_speed": "m/s, to the left",
    "yaw_rate": "rad/s",
    "steering": "rad, of the bicycle, left positive",
}


class Car(Fmi3Slave):
    """A car on level ground."""

    author = "carpark_mj"
    description = "Rigid-body car on tyres; steer and pedal in [-1, 1]"

    def __init__(self, **settings: Any) -> None:
        """Declares the variables; the first step compiles."""
        super().__init__(**settings)
        self.time, self.steer, self.pedal = 0.0, 0.0, 0.0
        self.vehicle = "compact"
        self.x, self.y, self.yaw, self.speed = 0.0, 0.0, 0.0, 0.0
        self.lateral_speed, self.yaw_rate, self.steering = 0.0, 0.0, 0.0
        self.finite = True
        time = {"causality": Fmi3Causality.independent}
        given = {"causality": Fmi3Causality.input}
        fixed = {"causality": Fmi3Causality.parameter}
        constant = {"variability": Fmi3Variability.fixed}
        self.register_variable(
            Float64("time", variability=Fmi3Variability.continuous, **time)
        )
        self.register_variable(
            Text("vehicle", description="preset", **fixed, **constant)
        )
        for name in ("steer", "pedal"):
            self.register_variable(Float64(name, description="in [-1, 1]", **given))
        for name, text in OUTPUTS.items():
            output = Fmi3Causality.output
            self.register_variable(Float64(name, description=text, causality=output))
        self.register_variable(Boolean("finite", causality=Fmi3Causality.output))

    def exit_initialization_mode(self) -> None:
        """Builds the car at the origin."""
        sim = SimConfig(ctrl_dt=PERIOD)
        config = EnvConfig(
            vehicle=self.vehicle, num_agents=1, num_parked_cars=0, sim=sim
        )
        env = ParkingEnv(config)
        self.physics = env.physics
        vehicles = env.fleet.of_kind(jnp.zeros(1, jnp.int32))
        self.state = self.physics.init(jnp.zeros((1, 3)), vehicles)
        self.advance = jax.jit(self.physics.step)

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Drives on; refuses a step that is no multiple of the period."""
        count = round(step_size / PERIOD)
        if count < 1 or abs(count * PERIOD - step_size) > 1e-6:
            print(f"a step must be a multiple of {PERIOD} s, not {step_size}")
            return False
        action = jnp.clip(jnp.array([[self.steer, self.pedal]], jnp.float32), -1.0, 1.0)
        for _ in range(count):
            self.state = self.advance(self.state, action)
        motion = self.physics.read(self.state)
        self.x, self.y, self.yaw = map(float, motion.pose_w[0])
        self.speed, self.lateral_speed = map(float, motion.velocity_b[0])
        self.yaw_rate = float(motion.yaw_rate[0])
        self.steering = float(motion.steering[0])
        self.finite = bool(motion.finite[0])
        return True
