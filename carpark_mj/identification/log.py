"""Logs of test drives: a table of commands and of the motion that followed."""

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from carpark_mj.reading import CsvRow, read_csv

_DEGREE = math.pi / 180
# Columns of a log: the quantity, and the column's unit in SI.
COLUMNS = {
    "time": ("time", 1.0),
    "time_ms": ("time", 1e-3),
    "steering_wheel": ("steering_wheel", 1.0),
    "steering_wheel_deg": ("steering_wheel", _DEGREE),
    "steering": ("steering", 1.0),
    "steering_deg": ("steering", _DEGREE),
    "pedal": ("pedal", 1.0),
    "acceleration": ("acceleration", 1.0),
    "x": ("x", 1.0),
    "y": ("y", 1.0),
    "yaw": ("yaw", 1.0),
    "yaw_deg": ("yaw", _DEGREE),
    "speed": ("speed", 1.0),
    "speed_kmh": ("speed", 1 / 3.6),
    "yaw_rate": ("yaw_rate", 1.0),
    "yaw_rate_deg": ("yaw_rate", _DEGREE),
}
POSE, RATES = ("x", "y", "yaw"), ("speed", "yaw_rate")
STEERING, PEDAL = ("steering_wheel", "steering"), ("pedal", "acceleration")
LARGEST = {
    "steering_wheel": (30.0, "rad"),
    "steering": (1.2, "rad"),
    "pedal": (1.0, ""),
    "acceleration": (15.0, "m/s^2"),
    "yaw": (1000.0, "rad"),
    "yaw_rate": (10.0, "rad/s"),
}
SHORTEST, LONGEST = 10.0, 300.0  # s
SLOWEST, FASTEST = 0.5, 60.0  # m/s, the top speed of a drive; poses may not jump
WIDEST_GAP = 0.25  # s between rows, for commands are interpolated


@dataclasses.dataclass(frozen=True)
class DriveLog:
    """A test drive in SI units."""

    time: np.ndarray  # (n,) increasing [s]
    steering: np.ndarray  # (n,) angle of the steering wheel or the road wheels [rad]
    pedal: np.ndarray  # (n,) in [-1, 1], or acceleration asked for [m/s^2]
    names: tuple[str, str]  # of these two columns, of `STEERING` and of `PEDAL`
    # (n,) by quantity of `POSE`, of `RATES` or of both; NaN where nothing is measured.
    measured: dict[str, np.ndarray]
    ignored: tuple[str, ...] = ()  # names of unknown columns

    @property
    def speed(self) -> np.ndarray:
        """(n,) forward speed [m/s], from the poses where it is not measured."""
        if "speed" in self.measured:
            return _filled(self.time, self.measured["speed"])
        x, y, yaw = (_filled(self.time, self.measured[name]) for name in POSE)
        # Over half a second, so that the noise of positions counts little.
        early = np.clip(self.time - 0.25, self.time[0], self.time[-1] - 0.5)
        moved = [
            np.interp(early + 0.5, self.time, p) - np.interp(early, self.time, p)
            for p in (x, y)
        ]
        return (moved[0] * np.cos(yaw) + moved[1] * np.sin(yaw)) / 0.5

    def at(self, name: str, time: np.ndarray) -> np.ndarray:
        """A measured quantity at times [s], by interpolation."""
        return np.interp(time, self.time, _filled(self.time, self.measured[name]))


def _filled(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    there = np.isfinite(values)
    return np.interp(time, time[there], values[there])


def read_log(path: Path) -> DriveLog:
    """Reads the log of a test drive; see `COLUMNS`."""
    rows = read_csv(path)
    if not rows:
        raise ValueError(f"{path} has no rows")
    names = {name.strip(): name for name in rows[0].cells}
    if len(names) < len(rows[0].cells):
        raise ValueError(f"{path} has a column twice")
    needed = ("time",), STEERING, PEDAL
    of: dict[str, str] = {}  # columns by quantity
    for choice in (*needed, *zip((*POSE, *RATES))):
        own = [x for x in names if x in COLUMNS and COLUMNS[x][0] in choice]
        if len(own) > 1:
            raise ValueError(f"{path} has {' and '.join(own)}: leave one of them out")
        of |= {COLUMNS[name][0]: name for name in own}
    missing = [" or ".join(choice) for choice in needed if not {*choice} & {*of}]
    seen = [group for group in (POSE, RATES) if {*group} <= {*of}]
    if not seen:
        missing.append("x, y and yaw or speed and yaw_rate")
    if missing:
        raise ValueError(f"{path} lacks the columns {'; '.join(missing)}")
    values = {
        quantity: np.array([_value(row, names[name], quantity) for row in rows])
        * COLUMNS[name][1]
        for quantity, name in of.items()
    }
    steering, pedal = (next(x for x in y if x in of) for y in (STEERING, PEDAL))
    measured = {name: values[name] for group in seen for name in group}
    if "yaw" in measured:
        there = np.isfinite(measured["yaw"])
        measured["yaw"][there] = np.unwrap(measured["yaw"][there])
    time, ignored = values["time"], tuple(x for x in names if x not in COLUMNS)
    commands = values[steering], values[pedal]
    log = DriveLog(time, *commands, (steering, pedal), measured, ignored)
    for fault in _faults(log, values):
        raise ValueError(f"{path}: {fault}")
    return log


def _value(row: CsvRow, column: str, quantity: str) -> float:
    """A cell; cells of the motion may be empty."""
    if quantity in (*POSE, *RATES) and not row.cells[column].strip():
        return math.nan
    value = row.number(column)
    if not math.isfinite(value):
        raise ValueError(f"{row.place}: {column} must be finite, not {value}")
    return value


def _faults(log: DriveLog, values: dict[str, np.ndarray]) -> Iterator[str]:
    """What makes a log useless."""
    steps, lasts = np.diff(log.time), log.time[-1] - log.time[0]
    if not (steps > 0).all():
        first, second = log.time[np.argmin(steps > 0) :][:2]
        yield f"time must increase, not go from {first:g} to {second:g} s"
    if not SHORTEST <= lasts <= LONGEST:
        yield f"the drive must last {SHORTEST:g} to {LONGEST:g} s, not {lasts:g}"
    if (gap := steps.max()) > WIDEST_GAP:
        after = log.time[steps.argmax()]
        apart = f"{gap:g}, after {after:g} s"
        yield f"rows must be at most {WIDEST_GAP:g} s apart, not {apart}"
    for name, (most, unit) in LARGEST.items():
        reached = np.nanmax(np.abs(values.get(name, 0.0)), initial=0.0)
        if reached > most:
            within = f"{name} must lie within ±{most:g} {unit}".rstrip()
            yield f"{within}, not reach {reached:g}"
    for name, column in log.measured.items():
        if np.isfinite(column).sum() < 2 * lasts:
            yield f"{name} must have at least 2 values per second"
    speed = np.abs(log.speed)
    if not SLOWEST <= (fastest := speed.max()) <= FASTEST:
        yield (
            f"the car must reach {SLOWEST:g} to {FASTEST:g} m/s, not {fastest:.3g} "
            f"(at {log.time[speed.argmax()]:g} s)"
        )
