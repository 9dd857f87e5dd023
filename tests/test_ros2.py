"""The ROS 2 example without ROS: its mappings fit the messages that it names."""

import json
import math
import socket
import sys
import threading
from types import ModuleType, SimpleNamespace

import pytest
from helpers.programs import ROOT

sys.path.append(str(ROOT / "examples" / "ros2"))

from carpark_mj_ros.messages import COMMAND, TOPICS, action, messages

PACKAGE = ROOT / "examples" / "ros2"

# Fields of the packages common_interfaces and rcl_interfaces.
_STAMP = {"sec": int, "nanosec": int}
_HEADER = {"stamp": _STAMP, "frame_id": str}
_VECTOR = dict.fromkeys("xyz", float)
_POSE = {"position": _VECTOR, "orientation": _VECTOR | {"w": float}}
_MARKER = {
    **{"header": _HEADER, "ns": str, "id": int, "type": int, "action": int},
    **{"pose": _POSE, "scale": _VECTOR, "color": dict.fromkeys("rgba", float)},
}
TYPES = {
    "rosgraph_msgs/msg/Clock": {"clock": _STAMP},
    "nav_msgs/msg/Odometry": {
        "header": _HEADER,
        "child_frame_id": str,
        "pose": {"pose": _POSE, "covariance": list},
        "twist": {"twist": {"linear": _VECTOR, "angular": _VECTOR}, "covariance": list},
    },
    "geometry_msgs/msg/PoseStamped": {"header": _HEADER, "pose": _POSE},
    "visualization_msgs/msg/MarkerArray": {"markers": [_MARKER]},
    "std_msgs/msg/String": {"data": str},
}
ANSWER = {
    "time": 12.4,
    "pose": [[1.0, 2.0, math.pi / 2]],
    "speed": [-0.5],
    "steering": [0.1],
    "goal": [[3.0, 4.0, math.pi]],
    "observation": [[0.0]],
    "obstacles": [{"pose": [5.0, 6.0, 0.3], "size": [4.5, 1.8]}],
    "parked": [False],
    "crashed": [True],
    "timed_out": [False],
}


def assert_fits(value, kind):
    if isinstance(kind, dict):
        assert isinstance(value, dict)
        assert not value.keys() - kind.keys()
        for name, part in value.items():
            assert_fits(part, kind[name])
    elif isinstance(kind, list):
        for one in value:
            assert_fits(one, kind[0])
    else:
        assert type(value) is kind


def test_messages_fit_their_types():
    found = messages(ANSWER)
    assert found.keys() == TOPICS.keys()
    for name, fields in found.items():
        assert_fits(fields, TYPES[TOPICS[name]])
    assert found["clock"]["clock"] == {"sec": 12, "nanosec": 400_000_000}
    turn = found["odom"]["pose"]["pose"]["orientation"]
    assert turn["z"] == pytest.approx(math.sqrt(0.5))
    assert turn["w"] == pytest.approx(math.sqrt(0.5))
    assert found["outcome"] == {"data": "crashed"}
    assert "goal" not in messages(ANSWER | {"goal": [None]})
    packages = (PACKAGE / "package.xml").read_text()
    for kind in (*TOPICS.values(), COMMAND):
        assert f"<exec_depend>{kind.split('/')[0]}<" in packages


@pytest.mark.parametrize(
    ("asked", "speed", "expected"),
    [
        ((0.3, 1.0), 0.5, [0.5, 0.5]),
        ((-0.9, 0.0), 2.0, [-1.0, -1.0]),
        ((0.0, -1.0), -1.0, [0.0, 0.0]),
    ],
)
def test_commands_become_actions(asked, speed, expected):
    drive = dict(zip(("steering_angle", "speed"), asked, strict=True))
    assert action(drive, speed, 0.6) == pytest.approx(expected)


class FakeNode:
    """As much of `rclpy.node.Node` as the example uses."""

    port = 0

    def __init__(self, name):
        self.name, self.parameters, self.published = name, {}, {}

    def declare_parameter(self, name, value):
        self.parameters[name] = FakeNode.port if name == "port" else value

    def get_parameter(self, name):
        return SimpleNamespace(value=self.parameters[name])

    def create_publisher(self, _kind, name, _depth):
        kept = self.published.setdefault(name, [])
        return SimpleNamespace(publish=kept.append)

    def create_subscription(self, _kind, name, call, _depth):
        self.subscribed = name, call

    def create_timer(self, period, call):
        self.timer = period, call


def test_the_node_steps_the_lot_and_publishes(monkeypatch):
    fakes = {
        "rclpy": {"init": None, "spin": None},
        "rclpy.node": {"Node": FakeNode},
        "rosidl_runtime_py": {},
        "rosidl_runtime_py.set_message": {
            "set_message_fields": lambda message, fields: message.__dict__.update(
                fields
            )
        },
        "rosidl_runtime_py.utilities": {
            "get_message": lambda kind: lambda: SimpleNamespace(kind=kind)
        },
    }
    for name, parts in fakes.items():
        module = ModuleType(name)
        module.__dict__.update(parts)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "carpark_mj_ros.node", raising=False)
    from carpark_mj_ros.node import Lot

    asked = []

    def answer(listener):
        connection, _ = listener.accept()
        with connection, connection.makefile("rw") as stream:
            for line in stream:
                asked.append(json.loads(line))
                print(json.dumps(ANSWER), file=stream, flush=True)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        monkeypatch.setattr(FakeNode, "port", listener.getsockname()[1])
        threading.Thread(target=answer, args=(listener,), daemon=True).start()
        node = Lot()
        topic, keep = node.subscribed
        assert topic == "command"
        keep(SimpleNamespace(drive=SimpleNamespace(steering_angle=0.3, speed=0.0)))
        node.timer[1]()
        node._file.close()
        node._lines.close()
    # The car reverses at 0.5 m/s, and shall stand.
    assert asked == [{"reset": {"seed": 0}}, {"action": [[0.5, 0.5]]}]
    assert node.published.keys() == TOPICS.keys()
    for name, sent in node.published.items():
        assert [message.kind for message in sent] == [TOPICS[name]] * 2
    assert node.published["outcome"][1].data == "crashed"
