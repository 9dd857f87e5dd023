"""Tasks for the planner, worked out apart from the environment."""

import math

import numpy as np

from carpark_mj.planning.paths import Driven, Progress, track
from carpark_mj.planning.search import Solids
from carpark_mj.suite.levels import load_held_out
from carpark_mj.vehicle import preset

# TPCAP's car.
CAR = preset("tpcap")


def case(level, number):
    """Start, goal, obstacles and extent of a held-out case, as float64."""
    layouts, _ = load_held_out(level)
    mask = np.asarray(layouts.wall_mask[number])
    solids = Solids(
        np.asarray(layouts.wall_pose[number], float)[mask],
        np.asarray(layouts.wall_size[number], float)[mask],
        np.zeros((0, 2)),
        np.zeros(0),
    )
    start, goal, extent = (
        np.asarray(part[number], float)
        for part in (layouts.spawn_pose[:, 0], layouts.bay_pose[:, 0], layouts.extent)
    )
    return start, goal, solids, extent


def drive(path, car=CAR, dt=0.2, steps=500, substeps=40):
    """A kinematic car with the pedal's rules that follows a path from its beginning.

    Returns:
        Poses of the rear axle (n, 3), speeds (n,), and largest distance to the path.
    """
    pose, speed, steering = path.segments[0].pose[0].copy(), 0.0, 0.0
    progress, h = Progress(), dt / substeps
    poses, speeds, error = [], [], 0.0
    for _ in range(steps):
        command = track(path, progress, car, Driven(pose.copy(), speed, steering), dt)
        progress, pedal = command.progress, command.pedal
        error = max(error, command.error)
        if progress.segment == len(path.segments) and speed == 0.0:
            break
        for _ in range(substeps):
            change = command.steer * car.max_steering - steering
            limit = car.steering_rate * h
            steering += min(max(change, -limit), limit)
            slow = abs(speed) < 0.3
            if abs(pedal) < 0.05 or (pedal * speed < 0 and abs(speed) > 0.1):
                brake = max(abs(pedal) * 4.0 * (abs(pedal) >= 0.05), 9.0 * slow)
                speed -= math.copysign(min(brake * h, abs(speed)), speed)
            else:
                speed += pedal * car.max_acceleration * h
            turn = math.tan(steering) / car.wheelbase
            cos, sin = math.cos(pose[2]), math.sin(pose[2])
            pose += h * speed * np.array([cos, sin, turn])
            poses.append(pose.copy())
            speeds.append(speed)
    return np.array(poses), np.array(speeds), error
