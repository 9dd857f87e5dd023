"""Drives an exported scene with MuJoCo alone and prints measurements of the car.

carpark_mj scene --num-agents 1 --num-parked-cars 0 --seed 11 --out scene.xml
python examples/drive_scene.py scene.xml

The car needs room for a circle to the left; exit code 2 means that it hit an obstacle.
"""

import json
import math
import sys

import mujoco

CAR = "agent0/"
SPEED = 1.5  # m/s


class HitError(Exception):
    """The car's body touches something."""


class Car:
    """Car `agent0` of a scene, driven by its three sliders."""

    def __init__(self, path: str) -> None:
        """Loads the scene."""
        self.model = mujoco.MjModel.from_xml_path(path)
        self.data = mujoco.MjData(self.model)
        self._body = self.model.body(f"{CAR}car").id

    @property
    def position(self) -> tuple[float, float]:
        """Rear axle's centre [m]."""
        x, y = self.data.joint(f"{CAR}root").qpos[:2]
        return float(x), float(y)

    @property
    def speed(self) -> float:
        """Along the car's axis [m/s]."""
        w, x, y, z = self.data.joint(f"{CAR}root").qpos[3:]
        yaw = math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
        vx, vy = self.data.joint(f"{CAR}root").qvel[:2]
        return math.cos(yaw) * vx + math.sin(yaw) * vy

    def drive(self, seconds, steer=0.0, speed=None, brake=0.0):
        """Holds the sliders, or a speed; returns the positions [m] on its way."""
        track = []
        for _ in range(round(seconds / self.model.opt.timestep)):
            self.data.actuator(f"{CAR}steer").ctrl = steer
            pedal = 0.0 if speed is None else speed / 3.0 + 1.5 * (speed - self.speed)
            self.data.actuator(f"{CAR}drive").ctrl = max(-0.6, min(1.0, pedal))
            self.data.actuator(f"{CAR}brake").ctrl = brake
            mujoco.mj_step(self.model, self.data)
            if self._body in self.model.geom_bodyid[self.data.contact.geom]:
                raise HitError(f"the car hit something after {self.data.time:.1f} s")
            track.append(self.position)
        return track


def circle_radius(track):
    """Radius [m] of the circle through three points a third of the track apart."""
    a, b, c = track[0], track[len(track) // 3], track[2 * len(track) // 3]
    area = abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2
    return math.dist(a, b) * math.dist(b, c) * math.dist(c, a) / (4 * area)


def main(path: str) -> dict[str, float]:
    """Stands, drives a circle, brakes; returns the measurements."""
    car = Car(path)
    start = car.position
    car.drive(10.0)
    drift = math.dist(start, car.position)

    wheelbase = float(car.model.body(f"{CAR}knuckle_fl").pos[0])
    steer = math.radians(30.0)
    car.drive(6.0, steer, SPEED)  # steer over and settle
    track = car.drive(10.0, steer, SPEED)
    before = car.speed
    begin = car.position
    car.drive(3.0, steer, brake=1.0)
    return {
        "drift_at_rest_in_10_s_mm": 1e3 * drift,
        "circle_radius_m": circle_radius(track),
        "wheelbase_over_tan_delta_m": wheelbase / math.tan(steer),
        "speed_m_s": before,
        "stopping_distance_m": math.dist(begin, car.position),
        "speed_after_braking_m_s": car.speed,
        "imported_carpark_mj": "carpark_mj" in sys.modules,
    }


if __name__ == "__main__":
    if len(sys.argv) != 2:
        print(f"usage: {sys.argv[0]} scene.xml", file=sys.stderr)
        sys.exit(2)
    try:
        print(json.dumps(main(sys.argv[1]), indent=2))
    except (HitError, KeyError, ValueError) as error:
        reason = " ".join(str(error.args[0]).split())
        print(f"{sys.argv[0]}: {sys.argv[1]}: {reason}", file=sys.stderr)
        sys.exit(2)
