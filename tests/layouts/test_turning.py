"""The narrowest aisles, against a car that is swept along its arc with shapely."""

import math

import jax
import numpy as np
import pytest
import shapely
from helpers.scenes import polygons

from carpark_mj.layouts import layout_config
from carpark_mj.layouts.standards import (
    AISLE_ANGLES,
    AISLE_WIDTHS,
    FOOT,
    DesignCar,
    least_aisle,
    least_parallel_aisle,
    one_way_aisle,
)
from carpark_mj.layouts.types import BayKind

CAR = DesignCar()
STEPS = 200


def swept(car, angle, end, reverse):
    """The car's way along one arc into a bay whose axis leaves the aisle at the origin.

    The bay's axis points into the bay at `angle` from +x, and the arc ends with the
    rear axle at `end` along it. Forwards the car comes along +x and turns left; in
    reverse it turns the other way round, backs in and ends heading out.
    """
    radius = car.turning_radius
    theta = math.radians(angle)
    axis = np.array([math.cos(theta), math.sin(theta)])
    normal = np.array([-axis[1], axis[0]])
    centre = end * axis + radius * normal  # of the turning circle
    back = np.linspace(0.0, theta, STEPS)  # how far the car is from being aligned
    heading = theta - back
    rear = centre + radius * np.stack([np.sin(heading), -np.cos(heading)], axis=1)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    offset = car.length / 2 - car.rear_overhang
    # Backing in, the same circle is driven with the nose where the tail was.
    middle = rear + (-offset if reverse else offset) * ahead
    pose = np.concatenate([middle, heading[:, None]], axis=1)
    return shapely.union_all(polygons(pose, np.full((STEPS, 2), car.size)))


def neighbours(car, angle, width, walled):
    """What stands beside the bay: cars in the neighbouring bays, or walls."""
    theta = math.radians(angle)
    cot = 1 / math.tan(theta)
    axis = np.array([math.cos(theta), math.sin(theta)])
    normal = np.array([-axis[1], axis[0]])
    if walled:
        wall = shapely.box(width / 2, 0.0, width / 2 + 0.2, 6.0)
        return wall.union(shapely.affinity.translate(wall, -width - 0.2))
    mouth = width / 2 * cot  # along the bay's axis; its outer corner is at the aisle
    pose = []
    for side in (1.0, -1.0):
        along = mouth - side * width * cot + car.length / 2
        place = along * axis + side * width * normal
        pose.append((*place, theta))
    return shapely.union_all(polygons(pose, [car.size] * 2))


def best_single_arc(car, angle, width, walled, reverse):
    """Searches all ends of the arc for the one that needs the narrowest aisle."""
    obstacles = neighbours(car, angle, width, walled)
    needed = math.inf
    for end in np.arange(-3.0, 2.2, 0.02):
        way = swept(car, angle, end, reverse)
        if way.intersection(obstacles).area < 1e-6:
            needed = min(needed, -way.bounds[1])
    return needed


CASES = [
    (90.0, 2.4, False, True),
    (90.0, 2.5, False, True),
    (90.0, CAR.width + 0.4, True, True),
    (60.0, 2.5, False, False),
    (45.0, 2.4, False, False),
    (75.0, 2.7, False, False),
]


@pytest.mark.parametrize(("angle", "width", "walled", "reverse"), CASES)
def test_least_aisle_is_what_the_best_single_arc_sweeps(angle, width, walled, reverse):
    formula = least_aisle(CAR, angle, width, walled)
    found = max(best_single_arc(CAR, angle, width, walled, reverse), CAR.width)
    # The search steps 2 cm along the bay's axis, and the sweep 0.4 deg; measured:
    # -1.5 to +1.4 cm.
    assert formula == pytest.approx(found, abs=0.03)


def test_a_hand_worked_case_backing_into_a_perpendicular_bay():
    # R = 2.637 / tan 34.187 deg = 3.882 m; neighbours 1.601 m off the axis (2.5 m bays)
    # q^2 = 2.983^2 - 2.282^2; front corner sqrt(4.782^2 + 3.495^2) = 5.923 m.
    assert CAR.turning_radius == pytest.approx(3.882, abs=1e-3)
    assert least_aisle(CAR, 90.0, 2.5, walled=False) == pytest.approx(4.00, abs=0.01)


def test_wider_bays_and_nimbler_cars_need_less():
    widths = np.linspace(2.3, 3.2, 10)
    for angle in (45.0, 60.0, 90.0):
        needed = [least_aisle(CAR, angle, w, walled=False) for w in widths]
        assert (np.diff(needed) <= 0).all()
    # A bay narrower than the car has no aisle.
    assert least_aisle(CAR, 90.0, 1.7, walled=True) == math.inf
    nimble = DesignCar(max_steering=math.radians(40))
    assert least_parallel_aisle(nimble) > least_parallel_aisle(CAR) > CAR.width
    assert least_aisle(nimble, 90.0, 2.5, False) < least_aisle(CAR, 90.0, 2.5, False)


def test_published_aisles_in_feet():
    feet = dict(zip(AISLE_ANGLES, np.array(AISLE_WIDTHS) / 0.3048, strict=True))
    for angle in AISLE_ANGLES:  # they let our car in
        least = least_aisle(CAR, angle, 8.5 * FOOT, walled=False)
        assert least < one_way_aisle(angle)
    assert feet[45.0] == pytest.approx(13.5)
    assert feet[60.0] == pytest.approx(18.5)
    assert feet[90.0] == pytest.approx(24.0)
    assert one_way_aisle(52.5) == pytest.approx((15.5 * 0.75 + 18.5 * 0.25) * 0.3048)


@pytest.mark.parametrize("name", ["square", "street", "garage_row", "dead_end", "lot"])
def test_families_say_how_roomy_its_bays_and_aisles_get(name):
    config = layout_config(name)
    assert all(entry.least(CAR) <= entry.aisle for entry in config.entries)
    draw = jax.jit(jax.vmap(config.generate))
    lots = jax.device_get(draw(jax.random.split(jax.random.key(1), 200)))
    ordinary = lots.bay_mask & (lots.bay_kind == BayKind.STANDARD)
    widest = lots.bay_size[ordinary][:, 1].max()
    most = max(entry.bay_width for entry in config.entries)
    assert 0.97 * most < widest < most + 1e-4
