"""Turning: radius, kerb circle, differential, understeer, step steer, lateral limit."""

import itertools
import math
from collections.abc import Mapping

import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from physics import formulas
from physics.runs import Run, Track, circle_radius, crossing, ramp, step
from physics.table import Curve, Row, Study, relative
from physics.testbed import Testbed

Cars = Mapping[str, VehicleParameters]

TURN = "R = L / tan(delta) + slip and scrub of the two-track car on brush tyres"
GEOMETRIC = "R = L / tan(delta)"
STEADY = 200  # substeps at the end of a run over which steady values are averaged


def expected_turn(
    bed: Testbed, params: VehicleParameters, steering: float, speed: float
) -> formulas.Turn:
    """What the tyre model should give: slipping tyres or pure geometry."""
    if bed.tyres == "brush":
        return formulas.steady_turn(params, steering, speed)
    drag = formulas.rolling_resistance(params)
    return formulas.Turn(formulas.turning_radius(params, steering), drag)


def turning(bed: Testbed, cars: Cars, quick: bool = False) -> Study:
    """Low-speed radius forwards and in reverse, and the kerb-to-kerb circle."""
    study, formula = Study(), TURN if bed.tyres == "brush" else GEOMETRIC
    speeds = (1.0, -1.0) if quick else (0.5, 1.0, 3.0, -1.0)
    # Measured within 0.003 % at 1 m/s and 0.02 % at 3 m/s.
    share = {0.5: 0.0005, 1.0: 0.0005, -1.0: 0.0005, 3.0: 0.001}
    for name, params in cars.items():
        locks = [f * params.max_steering for f in (0.3, 0.6, 0.85, 1.0)]
        cases = list(itertools.product(speeds, locks[-2:] if quick else locks))
        runs = [
            Run(
                params,
                8.0 + 8.0 / abs(speed),
                target=ramp(speed, 1.0, 2.0),
                steering=ramp(lock, 0.0, 1.0),
            )
            for speed, lock in cases
        ]
        errors: dict[float, list[tuple[float, float, float]]] = {v: [] for v in speeds}
        for (speed, lock), track in zip(cases, bed.drive(runs), strict=True):
            radius = circle_radius(track.position[track.at(7.0) :])
            reached = float(track.speed[-STEADY:].mean())
            expected = expected_turn(bed, params, lock, reached).radius
            way = "forwards" if speed > 0 else "reverse"
            angle = math.degrees(lock)
            study.rows.append(
                Row(
                    f"turning radius, {angle:.1f} deg, {abs(speed):g} m/s {way}",
                    name,
                    bed.tyres,
                    formula,
                    "m",
                    radius,
                    expected,
                    relative(expected, share[speed]),
                )
            )
            plain = formulas.turning_radius(params, lock)
            errors[speed].append(
                (angle, 100 * (radius / plain - 1), 100 * (expected / plain - 1))
            )
            if lock == params.max_steering and speed == 1.0:
                study.rows += kerb_rows(bed, name, track)
                study.rows.append(drag_row(bed, name, track, lock))
        for speed, points in errors.items():
            x, y, e = zip(*points, strict=True)
            label = f"{name}, {bed.tyres}, {speed:g} m/s"
            study.curves.append(Curve("turning_radius", label, x, y, "o"))
            study.curves.append(Curve("turning_radius", f"{label}, formula", x, e, "-"))
    return study


def kerb_rows(bed: Testbed, name: str, track: Track) -> list[Row]:
    """The outer front tyre's circle against geometry and the published figure."""
    params = track.params
    tail = slice(track.at(7.0), None)
    yaw = track.yaw[tail]
    x, y = params.wheelbase, -params.track_width / 2
    hub = track.position[tail] + np.stack(
        [x * np.cos(yaw) - y * np.sin(yaw), x * np.sin(yaw) + y * np.cos(yaw)], -1
    )
    measured = 2 * circle_radius(hub) + params.tyre_width
    share, why = (0.01, "") if bed.tyres == "contact" else (0.02, "scrub widens it")
    geometric = formulas.kerb_circle(params)
    rows = [
        Row(
            "kerb-to-kerb circle, geometry",
            name,
            bed.tyres,
            "D = 2 (L / sin(delta_o) + w / 2)",
            "m",
            measured,
            geometric,
            relative(geometric, share),
            why,
        )
    ]
    published = getattr(params, "turning_circle", None)
    if published is not None:
        rows.append(
            Row(
                "kerb-to-kerb circle, published",
                name,
                bed.tyres,
                "the maker's figure",
                "m",
                measured,
                published,
                relative(published, 0.025),
                "makers round to 0.1 m, and scrub widens it",
            )
        )
    return rows


def drag_row(bed: Testbed, name: str, track: Track, lock: float) -> Row:
    """Drive force of an open differential at full lock."""
    measured = track.drive[-STEADY:].sum(1).mean() / track.params.wheel_radius
    reached = float(track.speed[-STEADY:].mean())
    expected = expected_turn(bed, track.params, lock, reached).drag
    return Row(
        "drag at full lock, open differential, 1 m/s",
        name,
        bed.tyres,
        "balance of the two-track car" if bed.tyres == "brush" else "c_rr m g",
        "N",
        float(measured),
        expected,
        relative(expected, 0.01) if bed.tyres == "brush" else 20.0,
    )


def locked_axle(bed: Testbed, cars: Cars) -> Study:
    """Drag and radius with the driven wheels rigidly coupled."""
    study = Study()
    for name, params in cars.items():
        lock = 0.3 * params.max_steering
        run = Run(
            params,
            25.0,
            target=ramp(1.0, 1.0, 2.0),
            steering=ramp(lock, 0.0, 1.0),
            locked_axle=True,
        )
        (track,) = bed.drive([run])
        reached = float(track.speed[-STEADY:].mean())
        turn = formulas.steady_turn(params, lock, reached, locked=True)
        drag = float(track.drive[-STEADY:].sum(1).mean()) / params.wheel_radius
        radius = circle_radius(track.position[track.at(12.0) :])
        what = f"locked axle, {math.degrees(lock):.1f} deg, 1 m/s"
        formula = "two-track car, driven wheels at one speed, combined slip"
        study.rows += [
            Row(f"drag, {what}", name, bed.tyres, formula, "N", drag, turn.drag,
                relative(turn.drag, 0.01)),
            Row(f"radius, {what}", name, bed.tyres, formula, "m", radius, turn.radius,
                relative(turn.radius, 0.005)),
        ]  # fmt: skip
    return study


UNEVEN = (11 / 12, 12.5 / 12)  # of the cornering stiffness: a car that understeers


def understeer(bed: Testbed, cars: Cars) -> Study:
    """Understeer gradient at constant speed (ISO 4138, method 2) up to 0.25 g.

    Both axles of a preset have the same stiffness per load, which makes linear theory
    neutral, so the car is also driven with uneven axles.
    """
    study, speed = Study(), 20.0
    accelerations = np.arange(0.05, 0.251, 0.05) * GRAVITY
    degrees = math.degrees(GRAVITY)  # from rad s^2/m to deg/g
    for name, params in cars.items():
        for factors in ((1.0, 1.0), UNEVEN):
            steer = [math.atan(params.wheelbase * a / speed**2) for a in accelerations]
            runs = [
                Run(params, 12.0, speed=speed, target=speed, steering=ramp(s, 0.0, 2.0),
                    stiffness=factors) for s in steer
            ]  # fmt: skip
            points, corrected, transfers = [], [], []
            for command, track in zip(steer, bed.drive(runs), strict=True):
                v = float(track.speed[-STEADY:].mean())
                rate = float(track.yaw_rate[-STEADY:].mean())
                acceleration = v * rate
                excess = track.steering[-STEADY:].mean()
                excess -= math.atan(params.wheelbase * rate / v)
                points.append((acceleration, excess))
                turn = formulas.steady_turn(params, command, v, factors=factors)
                expected = command - math.atan(params.wheelbase / turn.radius)
                corrected.append((v**2 / turn.radius, expected))
                load = track.load[-STEADY:].mean(0)
                transfers.append((load[1] + load[3] - load[0] - load[2]) / 2)
            measured = degrees * float(np.polyfit(*np.transpose(points), 1)[0])
            linear = degrees * formulas.understeer_gradient(params, factors)
            brush = degrees * float(np.polyfit(*np.transpose(corrected), 1)[0])
            axles = (
                "uneven axles (11 and 12.5 per rad)" if factors == UNEVEN else "preset"
            )
            study.rows.append(
                Row(
                    f"understeer gradient, {axles}, linear",
                    name,
                    bed.tyres,
                    "K = (m / L) (b / C_f - a / C_r)",
                    "deg/g",
                    measured,
                    linear,
                    max(relative(linear, 0.25), 0.1),
                    "" if factors == UNEVEN else "linear theory is neutral here",
                )
            )
            study.rows.append(
                Row(
                    f"understeer gradient, {axles}, brush",
                    name,
                    bed.tyres,
                    "K of the two-track car: brush curvature, load transfer, scrub",
                    "deg/g",
                    measured,
                    brush,
                    max(relative(brush, 0.05), 0.01),
                )
            )
            g = accelerations / GRAVITY
            label = f"{name}, {axles.split(' (')[0]}"
            x = np.array(points)[:, 0] / GRAVITY
            study.curves += [
                Curve("understeer", label, x, np.degrees(np.array(points)[:, 1]), "o"),
                Curve("understeer", f"{label}, linear", g, linear * g, "--"),
                Curve("understeer", f"{label}, brush", np.array(corrected)[:, 0] / GRAVITY,
                      np.degrees(np.array(corrected)[:, 1]), "-"),
            ]  # fmt: skip
            if factors == (1.0, 1.0):
                expected = formulas.lateral_load_transfer(params, points[-1][0])
                study.rows.append(
                    Row(
                        "lateral load transfer, 0.25 g",
                        name,
                        bed.tyres,
                        "(m h + 4 I / r) a_y / T / (1 - m g h / (k T^2))",
                        "N",
                        float(transfers[-1]),
                        expected,
                        relative(expected, 0.005),
                    )
                )
    return study


def step_steer(bed: Testbed, cars: Cars, quick: bool = False) -> Study:
    """Step steer (ISO 7401): steady yaw-rate gain and time to 90 %."""
    study = Study()
    speeds = (10.0,) if quick else (5.0, 10.0, 20.0)
    for name, params in cars.items():
        steer = [params.wheelbase * 1.0 / v**2 for v in speeds]  # a_y about 1 m/s^2
        runs = [
            Run(params, 6.0, speed=v, target=v, steering=step(s, 1.0))
            for v, s in zip(speeds, steer, strict=True)
        ]
        for v, s, track in zip(speeds, steer, bed.drive(runs), strict=True):
            final = float(track.yaw_rate[-100:].mean())
            angle = track.steering
            start = crossing(track.time, angle, 0.5 * float(angle[-1]))
            rise = crossing(track.time, track.yaw_rate, 0.9 * final) - start
            reached = float(track.speed[-100:].mean())
            turn = formulas.steady_turn(params, s, reached)
            gain = reached / turn.radius / s
            time = np.arange(0.0, 4.0, 0.001)
            theory = formulas.step_response(params, v, time)
            expected = crossing(time, theory, 0.9 * theory[-1])
            study.rows += [
                Row(f"step steer, yaw-rate gain, {v:g} m/s", name, bed.tyres,
                    "v / (R delta) of the steady two-track turn", "1/s", final / s, gain,
                    relative(gain, 0.01)),
                Row(f"step steer, time to 90 %, {v:g} m/s", name, bed.tyres,
                    "linear single track with roll and relaxation, from half the step",
                    "s", rise, expected, max(0.02, 0.08 * expected)),
            ]  # fmt: skip
            label = f"{name}, {v:g} m/s"
            rows = slice(track.at(0.9), track.at(2.5))
            shifted = track.time[rows] - start
            study.curves += [
                Curve("step_steer", label, shifted, track.yaw_rate[rows] / final, "-"),
                Curve("step_steer", f"{label}, linear", time[:1500],
                      theory[:1500] / theory[-1], "--"),
            ]  # fmt: skip
    return study


def lateral_limit(bed: Testbed, cars: Cars) -> Study:
    """Largest lateral acceleration of a coasting car whose steering winds on."""
    study, speed = Study(), 15.0
    runs = [
        Run(p, 6.0, speed=speed, steering=ramp(0.3, 0.0, 6.0)) for p in cars.values()
    ]
    for name, track in zip(cars, bed.drive(runs), strict=True):
        grip = track.params.tyre.friction * GRAVITY
        acceleration = track.lateral_acceleration
        mean = np.convolve(acceleration, np.ones(50) / 50, "valid")
        study.rows.append(
            Row(
                "lateral limit, 15 m/s, coasting",
                name,
                bed.tyres,
                "0.93 to 1.0 mu g",
                "mu g",
                float(mean.max()) / grip,
                0.965,
                0.035,
                "brush tyres slide fully only at slip angles of about 20 deg, whose "
                "cosine is lost",
            )
        )
        angle = np.degrees(track.steering[25 : 25 + len(mean)])
        study.curves.append(
            Curve("lateral_limit", f"{name}, {bed.tyres}", angle, mean / grip, "-")
        )
    return study
