"""The ROS 2 example without ROS: its mappings fit the messages that it names."""

import math
import sys

import pytest
from helpers.programs import ROOT

sys.path.append(str(ROOT / "examples" / "ros2"))

from carpark_mj_ros.messages import COMMAND, TOPICS, action, messages

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
    packages = (ROOT / "examples" / "ros2" / "package.xml").read_text()
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
