"""Dry friction of four locked tyres in any MuJoCo, for a car that moves in the plane.

Dry friction is a vector of one length against the slip of a tyre; MuJoCo has it for
single coordinates only, or in contacts, which hop when they slide. So the contact patch
of each tyre hangs on `LINES` tendons, which end in points so far away that their
directions never change, and each tendon has a share of the friction: a polygon of twice
as many sides instead of a circle, 1.7 % off at most.
"""

import math

import mujoco

from carpark_mj.vehicle.mjcf import WHEELS, hub_positions
from carpark_mj.vehicle.parameters import VehicleParameters

LINES = 6
FAR = 1e6  # m; a car that slides 100 m turns a tendon by 1e-4 rad
# One over the sum of |cos| over all lines, its mean over the directions of slip.
SHARE = math.pi / (2 * LINES)
SOLREF, SOLIMP = (0.005, 1.0), (0.999, 0.999, 0.001, 0.5, 2.0)  # hard enough to hold
UNSEEN = 5  # group


def add_locked_tyres(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, params: VehicleParameters
) -> None:
    """Adds the tyres' friction to a car; their loads are those at rest on level ground.

    Args:
        spec: the model of the car.
        body: the car, whose frame is the rear axle's on the ground.
        params: the vehicle.
    """
    wheels = zip(WHEELS, hub_positions(params), params.static_loads, strict=True)
    for wheel, (x, y, _), load in wheels:
        patch = f"{body.name}/patch_{wheel}"
        body.add_site(name=patch, pos=[x, y, 0.0], group=UNSEEN)
        for line in range(LINES):
            tendon = spec.add_tendon(name=f"{patch}{line}", group=UNSEEN)
            tendon.wrap_site(patch)
            tendon.wrap_site(_far_point(spec, line))
            tendon.frictionloss = SHARE * params.tyre.friction * load
            tendon.solref_friction, tendon.solimp_friction = SOLREF, SOLIMP


def _far_point(spec: mujoco.MjSpec, line: int) -> str:
    """Name of the world's site in the direction of a line."""
    name = f"far{line}"
    if spec.site(name) is None:
        angle = math.pi * line / LINES
        where = [FAR * math.cos(angle), FAR * math.sin(angle), 0.0]
        spec.worldbody.add_site(name=name, pos=where, group=UNSEEN)
    return name
