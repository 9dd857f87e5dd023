"""Least squares of a test drive: values, intervals, and the vehicle file they make.

The unknowns are the parameters sought and the start of every piece of the drive, in
units of what is known of them before (`Parameter.doubt`), which counts as a
measurement. Residuals are divided by their standard deviation in the last fit;
derivatives are central differences in float64.

Two estimates make an interval, the wider counts. The inverse of Fisher's information,
with (1 + r) / (1 - r) times the variance where successive residuals correlate by r,
knows noise. The jackknife, which leaves out half a piece at a time, also knows errors
of the model that last: slopes, wind, other tyres (the CR3 covariance of clusters, Bell
and McCaffrey 2002, with Student's t).
"""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
import yaml  # Flax brings it
from scipy.optimize import least_squares
from scipy.stats import t as student

from carpark_mj.geometry.se2 import wrap_angle
from carpark_mj.identification.log import DriveLog
from carpark_mj.identification.simulation import SIM_DT, Replay
from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.sheet import Sheet

RANK = 1e-4  # eigenvalue of the scaled information that derivatives can make of none


class Parameter(NamedTuple):
    """How one number is sought; shares of the vehicle's value where `relative`."""

    unit: str  # its unit
    relative: bool  # whether the others are shares
    least: float  # lower bound
    # for derivatives. It moves events, such as the closing of the holding brake, by
    # several substeps; less would take them for fixed
    step: float
    doubt: float  # standard deviation of the vehicle's value
    widest: float  # half the longest interval of an identifiable number, a share of it
    needs: str  # what makes it identifiable in a drive


PARAMETERS = {
    "steering_delay": Parameter(
        "s", False, -1.0, 0.02, 0.3, 0.1, "steering to and fro at 1 m/s or more"
    ),
    "pedal_delay": Parameter(
        "s", False, -1.0, 0.02, 0.3, 0.1, "a pedal pressed and released several times"
    ),
    "steering_ratio": Parameter(
        "", True, 0.05, 1e-2, 0.5, 0.1, "small and large steering angles"
    ),
    "steering_offset": Parameter(
        "rad", False, -1.0, 5e-3, 0.05, 0.01, "steering to both sides, or straight on"
    ),
    "cornering_stiffness": Parameter(
        "1/rad", True, 0.05, 5e-2, 0.5, 0.25, "tight turns at 2.5 m/s or more"
    ),
    "max_acceleration": Parameter("m/s^2", True, 0.05, 1e-2, 0.5, 0.1, "starts"),
    "max_deceleration": Parameter(
        "m/s^2", True, 0.05, 1e-2, 0.5, 0.1, "braking from 1 m/s or more"
    ),
    "rolling_resistance": Parameter(
        "", True, 0.0, 0.1, 0.5, 0.5, "coasting for several seconds"
    ),
    "drive_lag": Parameter(
        "s", False, 0.0, 0.02, 0.1, 0.1, "a pedal pressed and released quickly"
    ),
    "lateral_relaxation": Parameter(
        "m", True, 0.1, 0.1, 0.5, 0.5, "quick steering at 2.5 m/s or more"
    ),
    "patch_radius": Parameter(
        "m", True, 0.0, 0.1, 0.5, 0.5, "large steering angles below 1 m/s"
    ),
}
HALVES = 2  # blocks of a piece that the jackknife leaves out
_START_STEPS = np.array([1e-2, 1e-2, 5e-3, 2e-2])  # m, m, rad, m/s
_START_DOUBTS = np.array([3.0, 3.0, 0.5, 1.0])  # of the log's own guess, likewise
# Of sensors, before residuals determine it.
_NOISE = {"x": 0.05, "y": 0.05, "yaw": 0.01, "speed": 0.05, "yaw_rate": 0.01}
_LEAST_NOISE = 1e-4  # of these
_ROUNDS, _LOOKS = 4, 30
_WITHIN = 0.2  # doubts, how far within its bounds the search begins
_ENOUGH = 0.2  # what the sum of squares falls by when it has converged


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A number that was sought."""

    value: float  # the best one, or the vehicle's if it is not identifiable
    error: float  # half the 95 % interval
    identifiable: bool  # whether the log determines it


@dataclasses.dataclass(frozen=True)
class Identification:
    """Parameters of a car from a log."""

    estimates: dict[str, Estimate]  # by name, as `PARAMETERS`
    residuals: dict[str, float]  # root mean square by quantity measured, in SI units


def identify(
    log: DriveLog, params: VehicleParameters, ahead: float, sim_dt: float = SIM_DT
) -> Identification:
    """Fits a log; see the module.

    A number is identifiable if half its interval is at most `Parameter.widest`; the
    others keep the vehicle's values `params`. Positions in the log are those of a point
    so far `ahead` of the rear axle [m]; `sim_dt` is the substep of the simulation [s].
    """
    problem = _Problem(Replay(log, params, ahead, sim_dt))
    unknown = np.maximum(0.0, problem.least + _WITHIN)
    for _ in range(_ROUNDS):
        unknown = least_squares(
            lambda x: problem.look(x)[:, -1],
            unknown,
            lambda x: problem.look(x)[:, :-1],  # pyright: ignore[reportArgumentType]
            (problem.least, np.inf),
            ftol=_ENOUGH / problem.measured.sum(),
            max_nfev=_LOOKS,
        ).x
        before, problem.noise = problem.noise, problem.spread(unknown)
        if np.abs(np.log(problem.noise / before)).max() < 0.02:
            break
    own, doubt = problem.own, problem.scaled("doubt")
    values = own + unknown[: len(own)] * doubt
    errors = doubt * problem.errors(unknown)
    clear = errors <= problem.scaled("widest", values)
    rows = np.where(clear, values, own).tolist(), errors.tolist(), clear.tolist()
    return Identification(
        {k: Estimate(*row) for k, *row in zip(PARAMETERS, *rows, strict=True)},
        dict(zip(problem.replay.channels, problem.noise.tolist(), strict=True)),
    )


class _Problem:
    """Residuals of a replay, and their derivatives.

    `measured` (channels, n) says where it is, `own` (p,) are the vehicle's values,
    `least` (p + 4 pieces,) bounds of the unknowns, `noise` (channels,) deviations.
    """

    def __init__(self, replay: Replay) -> None:
        self.replay, self.measured = replay, np.isfinite(replay.measured)
        self.own = np.array([float(x) for x in replay.own])
        least = (self.scaled("least") - self.own) / self.scaled("doubt")
        self.least = np.append(least, np.full(replay.starts.size, -np.inf))
        self.noise = np.array([_NOISE[name] for name in replay.channels])
        self._last = (np.empty(0),) * 3

    def scaled(self, what: str, values: np.ndarray | None = None) -> np.ndarray:
        """A quantity (p,) of `PARAMETERS`, absolute: shares are of `own` by default."""
        of = self.own if values is None else values
        rows = zip(PARAMETERS.values(), of, strict=True)
        return np.array([getattr(p, what) * (x if p.relative else 1) for p, x in rows])

    def look(self, unknown: np.ndarray) -> np.ndarray:
        """Derivatives (rows, unknowns) at a point and, as last column, residuals."""
        p, s, n = len(self.own), len(_START_STEPS), len(unknown)
        rows = [np.column_stack([np.eye(n), unknown])]
        for k, triangle in enumerate(self._triangles(unknown, self.noise)):
            triangle = triangle.reshape(-1, p + s + 1)
            part = np.zeros((len(triangle), n + 1))
            part[:, :p], part[:, -1] = triangle[:, :p], triangle[:, -1]
            part[:, p + s * k : p + s * (k + 1)] = triangle[:, p:-1]
            rows.append(part)
        return np.concatenate(rows)

    def _triangles(self, unknown: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Of derivatives and residuals, by QR: (pieces, halves, p + 5, p + 5).

        They stand for the measurements, with equal squares and products.
        """
        residual, slope = self._simulated(unknown)
        both = np.append(slope, residual[None], axis=0) / noise[:, None]
        both, size = np.where(self.measured, both, 0.0), len(both)
        found = []
        for k in range(len(self.replay.starts)):
            rows = np.flatnonzero(self.replay.recording.piece == k)
            for half in np.array_split(rows, HALVES):
                part = both[..., half].reshape(size, -1).T
                full = np.append(part, np.zeros((size, size)), axis=0)
                found.append(np.linalg.qr(full, mode="r"))
        return np.reshape(found, (-1, HALVES, size, size))

    def _simulated(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (channels, n) and their derivatives (p + 4, channels, n)."""
        if not np.array_equal(unknown, self._last[0]):
            p, s, doubt = len(self.own), len(_START_STEPS), self.scaled("doubt")
            steps = np.append(self.scaled("step") / doubt, _START_STEPS / _START_DOUBTS)
            below = np.append(unknown[:p] - self.least[:p], np.full(s, np.inf))
            up, down = np.diag(steps), -np.diag(np.minimum(steps, below))
            shifts = np.concatenate([np.zeros((1, p + s)), up, down])
            starts = unknown[p:].reshape(-1, s) + shifts[:, None, p:]
            seen = self.replay.simulate(
                self.own + doubt * (unknown[:p] + shifts[:, :p]),
                self.replay.starts + _START_DOUBTS * starts,
            )
            residual = seen[0] - self.replay.measured
            if "yaw" in self.replay.channels:
                yaw = self.replay.channels.index("yaw")
                residual[yaw] = np.asarray(wrap_angle(residual[yaw]))
            apart = np.diag(up - down)[:, None, None]
            slope = (seen[1 : 1 + p + s] - seen[1 + p + s :]) / apart
            self._last = unknown.copy(), residual, slope
        return self._last[1], self._last[2]

    def spread(self, unknown: np.ndarray) -> np.ndarray:
        """Standard deviations (channels,) of the residuals."""
        residual = np.where(self.measured, self._simulated(unknown)[0], 0.0)
        # Numbers fitted, shared among the quantities.
        free = self.measured.sum(axis=1) - len(unknown) / len(residual)
        least = [_LEAST_NOISE * _NOISE[name] for name in self.replay.channels]
        squares = np.sum(residual**2, axis=1)
        return np.maximum(np.sqrt(squares / np.maximum(free, 1)), least)

    def errors(self, unknown: np.ndarray) -> np.ndarray:
        """Half the 95 % intervals (p,), in units of the doubts."""
        p, known = len(self.own), np.eye(len(self.own))
        starts = unknown[p:].reshape(len(self.replay.starts), 1, -1)
        triangles = self._triangles(unknown, self.noise)
        squares = np.einsum("khri,khrj->khij", triangles, triangles)
        piece = squares.sum(axis=1, keepdims=True)
        whole = _without_starts(piece, starts)
        others = whole.sum(axis=0) + np.column_stack([known, unknown[:p]])
        others = others - whole + _without_starts(piece - squares, starts)
        moved = np.linalg.solve(others[..., :p], others[..., p:])
        count = squares.shape[0] * HALVES
        jackknife = np.sqrt((count - 1) / count * np.sum(moved**2, axis=(0, 1, 3)))

        triangles = self._triangles(unknown, self.noise * self._redundancy(unknown))
        piece = np.einsum("khri,khrj->kij", triangles, triangles)
        information = _without_starts(piece, starts[:, 0]).sum(axis=0)[:, :p]
        size = np.sqrt(np.maximum(np.diag(information), 1e-300))
        values, vectors = np.linalg.eigh(information / np.outer(size, size))
        values[values < RANK] = 0.0
        information = (vectors * values) @ vectors.T * np.outer(size, size)
        fisher = np.sqrt(np.diag(np.linalg.inv(information + known)))
        quantiles = student.ppf(0.975, [np.inf, count - 1])
        return np.maximum(quantiles[0] * fisher, quantiles[1] * jackknife)

    def _redundancy(self, unknown: np.ndarray) -> np.ndarray:
        """Factor (channels,) on the noise, as successive residuals correlate."""
        pairs = zip(self._simulated(unknown)[0], self.measured, strict=True)
        rows = [row[there] for row, there in pairs]
        r = [np.sum(x[1:] * x[:-1]) / max(np.sum(x * x), 1e-300) for x in rows]
        r = np.clip(r, 0.0, 0.999)
        return np.sqrt((1 + r) / (1 - r))


def _without_starts(squares: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Information and, as last column, gradient for the best starts (..., p, p + 1)."""
    count = starts.shape[-1]
    p, squares = squares.shape[-1] - 1 - count, squares.copy()
    squares[..., p:-1, p:-1] += np.eye(count)
    squares[..., p:-1, -1] += starts
    across = np.linalg.solve(squares[..., p:-1, p:-1], squares[..., p:-1, :])
    left = squares[..., :p, :] - squares[..., :p, p:-1] @ across
    return np.delete(left, np.s_[p:-1], axis=-1)


# Settings of an environment for numbers that a vehicle does not have.
PLACES = {
    "steering_delay": "sim.steering_delay",
    "pedal_delay": "sim.pedal_delay",
    "steering_offset": "randomization.steering_offset",
}


def place(name: str, log: DriveLog) -> str:
    """Where a number of `Sought` belongs."""
    if name == "steering_ratio" and log.names[0] == "steering":
        return "a factor of the log's steering"
    return PLACES.get(name, "vehicle file")


def vehicle_text(name: str, sheet: Sheet, found: Identification, log: DriveLog) -> str:
    """All parameters of a car as YAML; the sheet has what is not identifiable."""
    values: dict[str, Any] = {"name": name} | dataclasses.asdict(sheet.params)
    lines = [
        "# Identified from the log of a test drive; intervals are at 95 %. The rest is",
        "# the vehicle's that was given.",
    ]
    for key, estimate in found.estimates.items():
        shown = "is not identifiable from the log"
        if estimate.identifiable:
            shown = f"{estimate.value:.4g} ± {estimate.error:.2g}"
            shown += f" {PARAMETERS[key].unit}".rstrip()
            home = values["tyre"] if key in values["tyre"] else values
            if key in home:
                home[key] = estimate.value
        lines.append(f"# {key} {shown}: {place(key, log)}")
    if sheet.estimated:
        lines.append(f"# estimated: {', '.join(sheet.estimated)}")
    text = yaml.safe_dump(_rounded(values), allow_unicode=True, sort_keys=False)
    return "\n".join([*lines, text])


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    return float(f"{value:.6g}") if isinstance(value, float) else value
