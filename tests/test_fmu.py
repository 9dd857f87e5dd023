"""The car as an FMU moves as the car of an environment."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.programs import ROOT

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv

fmpy = pytest.importorskip("fmpy")
pytest.importorskip("pythonfmu3")
pytestmark = pytest.mark.slow
STEER, PEDAL, SECONDS = 0.3, 0.6, 3.0


def test_an_fmu_drives_as_the_environment_s_car(tmp_path):
    car = ROOT / "examples" / "fmu" / "car.py"
    build = (sys.executable, "-m", "pythonfmu3", "build", "-f", str(car))
    subprocess.run((*build, "--dest", str(tmp_path)), check=True, capture_output=True)
    times = np.arange(0.0, SECONDS + 0.1, 0.1)
    kinds = [("time", float), ("steer", float), ("pedal", float)]
    rows = fmpy.simulate_fmu(
        str(tmp_path / "Car.fmu"),
        stop_time=SECONDS,
        step_size=0.02,
        output_interval=0.2,
        input=np.array([(time, STEER, PEDAL) for time in times], kinds),
        output=["x", "y", "yaw", "speed", "steering", "finite"],
        start_values={"vehicle": "city"},
    )
    config = EnvConfig(vehicle="city", num_agents=1, num_parked_cars=0)
    env = ParkingEnv(config)
    vehicles = env.fleet.of_kind(jnp.zeros(1, jnp.int32))
    state = env.physics.init(jnp.zeros((1, 3)), vehicles)
    step, action = jax.jit(env.physics.step), jnp.array([[STEER, PEDAL]])
    for row in rows[1:]:
        state = step(state, action)
        motion = env.physics.read(state)
        expected = [*motion.pose_w[0], motion.speed[0], motion.steering[0]]
        found = [row[name] for name in ("x", "y", "yaw", "speed", "steering")]
        np.testing.assert_allclose(found, expected, atol=2e-4)
        assert row["finite"]
    assert rows["x"][-1] > 3.0
