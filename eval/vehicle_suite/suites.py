"""Which manoeuvres each tyre model drives, and all of them driven."""

from collections.abc import Callable, Iterator, Sequence
from typing import Literal

from carpark_mj.vehicle import VehicleParameters, preset
from vehicle_suite import (
    braking,
    energy,
    handling,
    numerics,
    options,
    pedals,
    standstill,
    statics,
    turning,
)
from vehicle_suite.contact import ContactTestbed
from vehicle_suite.contact_engines import contact_engines
from vehicle_suite.suspension import suspension
from vehicle_suite.table import Study
from vehicle_suite.testbed import BrushTestbed, Testbed

Tyres = Literal["brush", "contact"]
Manoeuvre = Callable[[Testbed, str, VehicleParameters, bool], Study]

COMMON: tuple[Manoeuvre, ...] = (
    turning.turning,
    braking.stops,
    braking.coast_down,
    braking.load_transfer,
    statics.axle_loads,
    statics.slope_hold,
    statics.slip_threshold,
    energy.balance,
    numerics.mirror,
    handling.lateral_limit,
    statics.scrub_torque,
    numerics.convergence,
)
SUITES: dict[Tyres, tuple[Manoeuvre, ...]] = {
    "brush": (
        *COMMON,
        turning.locked_axle,
        handling.understeer,
        handling.step_steer,
        numerics.engines,
        pedals.harder_is_slower,
        pedals.hold_on_ice,
        pedals.creep,
        standstill.coast_after_release,
        standstill.stop_from_a_walk,
        standstill.taps,
        standstill.speed_control,
        standstill.reversing,
        options.delays,
        options.automatic,
        options.odometry,
        options.wheel_stop,
        options.ramp,
    ),
    "contact": (*COMMON, handling.rolling_turns, contact_engines, suspension),
}
TESTBEDS: dict[Tyres, Callable[[], Testbed]] = {
    "brush": BrushTestbed,
    "contact": ContactTestbed,
}


def drive_suites(
    tyres: Sequence[Tyres], presets: Sequence[str], quick: bool
) -> Iterator[Study]:
    """Drives every manoeuvre; all rows and curves of a car on its tyres in a study.

    Args:
        tyres: tyre models.
        presets: cars, by name.
        quick: fewer cases, shorter runs.
    """
    for model in tyres:
        bed = TESTBEDS[model]()
        for name in presets:
            study = Study(name, model)
            for manoeuvre in SUITES[model]:
                part = manoeuvre(bed, name, preset(name), quick)
                study.rows.extend(part.rows)
                study.curves.extend(part.curves)
            yield study
