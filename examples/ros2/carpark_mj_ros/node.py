"""The node: steps the lot of `carpark_mj serve` at every period of the clock.

carpark_mj serve zero --layout square_compact --num-agents 1     # in its environment
ros2 run carpark_mj_ros lot --ros-args -p max_steering:=0.6      # in that of ROS
"""

import json
import socket
from typing import Any

import rclpy
from rclpy.node import Node
from rosidl_runtime_py.set_message import set_message_fields
from rosidl_runtime_py.utilities import get_message

from carpark_mj_ros.messages import COMMAND, TOPICS, action, messages


class Lot(Node):
    """Publishes a lot's messages, and drives its car as `command` asks."""

    def __init__(self) -> None:
        """Connects, and resets the lot."""
        super().__init__("lot")
        defaults = {"port": 8790, "seed": 0, "period": 0.2, "max_steering": 0.6}
        for name, value in defaults.items():
            self.declare_parameter(name, value)
        self._lines = socket.create_connection(("127.0.0.1", self.value("port")))
        self._file = self._lines.makefile("rw")
        self._out = {
            name: self.create_publisher(get_message(kind), name, 10)
            for name, kind in TOPICS.items()
        }
        self._drive = {"steering_angle": 0.0, "speed": 0.0}
        self.create_subscription(get_message(COMMAND), "command", self._keep, 10)
        self._answer = self._ask({"reset": {"seed": self.value("seed")}})
        self.create_timer(self.value("period"), self._step)

    def value(self, name: str) -> Any:
        """A parameter."""
        return self.get_parameter(name).value

    def _keep(self, message: Any) -> None:
        drive = message.drive
        self._drive = {name: getattr(drive, name) for name in self._drive}

    def _step(self) -> None:
        speed = self._answer["speed"][0]
        move = action(self._drive, speed, self.value("max_steering"))
        self._answer = self._ask({"action": [move]})

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        print(json.dumps(request), file=self._file, flush=True)
        answer = json.loads(self._file.readline())
        if "error" in answer:
            raise RuntimeError(answer["error"])
        for name, fields in messages(answer).items():
            message = get_message(TOPICS[name])()
            set_message_fields(message, fields)
            self._out[name].publish(message)
        return answer


def main() -> None:
    """Runs until it is interrupted."""
    rclpy.init()
    rclpy.spin(Lot())
