"""Messages of a lot by their fields, as mappings; needs neither ROS nor carpark_mj.

Answers are those of `carpark_mj serve`. The node fills ROS messages with the mappings.
"""

import math
from typing import Any

FRAME, CAR = "map", "base_footprint"  # the middle of the car's footprint
HEIGHT = 1.5  # m, of the boxes of obstacles
GAIN = 1.0  # of the pedal per m/s of missing speed
TOPICS = {
    "clock": "rosgraph_msgs/msg/Clock",
    "odom": "nav_msgs/msg/Odometry",
    "goal": "geometry_msgs/msg/PoseStamped",
    "obstacles": "visualization_msgs/msg/MarkerArray",
    "outcome": "std_msgs/msg/String",  # parked, crashed, timed_out; empty = it drives
}
COMMAND = "ackermann_msgs/msg/AckermannDriveStamped"


def messages(answer: dict[str, Any], agent: int = 0) -> dict[str, dict[str, Any]]:
    """The messages of an answer, by topic."""
    time = answer["time"]
    stamp = {"sec": int(time), "nanosec": round(1e9 * (time % 1.0))}
    header = {"stamp": stamp, "frame_id": FRAME}
    twist = {"linear": {"x": answer["speed"][agent]}}
    found: dict[str, dict[str, Any]] = {
        "clock": {"clock": stamp},
        "odom": {
            "header": header,
            "child_frame_id": CAR,
            "pose": {"pose": pose(*answer["pose"][agent])},
            "twist": {"twist": twist},
        },
        "obstacles": {
            "markers": [
                {
                    "header": header,
                    "id": number,
                    "type": 1,  # CUBE
                    "pose": pose(*one["pose"]),
                    "scale": dict(zip("xyz", (*one["size"], HEIGHT), strict=True)),
                    "color": {"r": 0.5, "g": 0.5, "b": 0.5, "a": 1.0},
                }
                for number, one in enumerate(answer["obstacles"])
            ]
        },
        "outcome": {
            "data": ", ".join(
                name
                for name in ("parked", "crashed", "timed_out")
                if name in answer and answer[name][agent]
            )
        },
    }
    if (goal := answer["goal"][agent]) is not None:
        found["goal"] = {"header": header, "pose": pose(*goal)}
    return found


def pose(x: float, y: float, yaw: float) -> dict[str, Any]:
    """A pose in the plane."""
    turn = {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {"position": {"x": x, "y": y}, "orientation": turn}


def action(drive: dict[str, float], speed: float, max_steering: float) -> list[float]:
    """Steer and pedal in [-1, 1] of the fields of an `AckermannDrive`.

    Args:
        drive: `steering_angle` [rad] and `speed` [m/s] that are asked for.
        speed: of the car [m/s].
        max_steering: angle of full lock [rad].
    """
    pedal = GAIN * (drive["speed"] - speed)
    values = drive["steering_angle"] / max_steering, pedal
    return [min(max(value, -1.0), 1.0) for value in values]
