"""Least squares of a test drive: values, intervals, and what the log cannot tell.

The unknowns are the parameters sought and the start of every piece of the drive, in
units of what is known of them before (`Parameter.doubt`), which counts as a
measurement. Residuals are divided by their standard deviation in the last fit;
derivatives are central differences in float64.

Two estimates make an interval, the wider counts. The inverse of Fisher's information,
with (1 + r) / (1 - r) times the variance where successive residuals correlate by r,
knows noise. The jackknife, which leaves out one piece at a time, also knows errors of
the model that last: slopes, wind, other tyres (the CR3 covariance of clusters, Bell and
McCaffrey 2002, with Student's t of as many pieces).
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from carpark_mj.geometry.se2 import wrap_angle
from carpark_mj.identification.log import DriveLog
from carpark_mj.identification.simulation import SIM_DT, Replay, Sought
from carpark_mj.vehicle.parameters import VehicleParameters

RANK = 1e-4  # eigenvalue of the scaled information that derivatives can make of none


class Parameter(NamedTuple):
    """How one number is sought; shares of the vehicle's value where `relative`.

    Attributes:
        unit: its unit.
        relative: whether the others are shares.
        least: it can have.
        step: for derivatives, which moves events, such as the closing of the holding
            brake, by several substeps; less would take them for fixed.
        doubt: standard deviation of the vehicle's value.
        widest: half the longest interval with which the log tells it, a share of the
            value found.
        needs: what tells it in a drive.
    """

    unit: str
    relative: bool
    least: float
    step: float
    doubt: float
    widest: float
    needs: str


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
        "s", False, 0.0, 0.02, 0.1, 0.05, "a pedal pressed and released quickly"
    ),
    "lateral_relaxation": Parameter(
        "m", True, 0.1, 0.1, 0.5, 0.25, "quick steering at 2.5 m/s or more"
    ),
    "patch_radius": Parameter(
        "m", True, 0.0, 0.1, 0.5, 0.5, "large steering angles below 1 m/s"
    ),
}
_START_STEPS = np.array([1e-2, 1e-2, 5e-3, 2e-2])  # m, m, rad, m/s
_START_DOUBTS = np.array([3.0, 3.0, 0.5, 1.0])  # of the log's own guess, likewise
# Of sensors, before residuals tell them.
_NOISE = {"x": 0.05, "y": 0.05, "yaw": 0.01, "speed": 0.05, "yaw_rate": 0.01}
_LEAST_NOISE = 1e-4  # of these
_ROUNDS, _LOOKS = 4, 30
_WITHIN = 0.2  # doubts, how far within its bounds the search begins
_ENOUGH = 0.2  # what the sum of squares falls by when it has converged


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A number that was sought.

    Attributes:
        value: the best one, or the vehicle's if the log does not tell it.
        error: half the 95 % interval.
        told: whether the log tells it.
    """

    value: float
    error: float
    told: bool


@dataclasses.dataclass(frozen=True)
class Identification:
    """What a log tells.

    Attributes:
        estimates: by name, as `Sought`.
        residuals: root mean square by the quantity measured, in SI units.
    """

    estimates: dict[str, Estimate]
    residuals: dict[str, float]


def identify(
    log: DriveLog, params: VehicleParameters, ahead: float, sim_dt: float = SIM_DT
) -> Identification:
    """Fits a log; see the module.

    A number is told if half its interval is at most `Parameter.widest`; the others keep
    the vehicle's values.

    Args:
        log: the log.
        params: the vehicle where the log does not tell it.
        ahead: of the rear axle, the point whose positions are in the log [m].
        sim_dt: substep of the simulation [s].
    """
    problem = _Problem(Replay(log, params, ahead, sim_dt))
    unknown = np.maximum(0.0, problem.least + _WITHIN)
    for _ in range(_ROUNDS):
        unknown = least_squares(
            lambda x: problem.look(x)[:, -1],
            unknown,
            lambda x: problem.look(x)[:, :-1],
            (problem.least, np.inf),
            ftol=_ENOUGH / problem.rows,
            max_nfev=_LOOKS,
        ).x
        before, problem.noise = problem.noise, problem.spread(unknown)
        if np.abs(np.log(problem.noise / before)).max() < 0.02:
            break
    values = problem.own + unknown[: problem.sought] * problem.scaled("doubt")
    errors = problem.scaled("doubt") * problem.errors(unknown)
    told = errors <= problem.scaled("widest", values)
    estimates = {
        name: Estimate(float(v if t else own), float(error), bool(t))
        for name, v, own, error, t in zip(
            Sought._fields, values, problem.own, errors, told, strict=True
        )
    }
    spread = problem.noise.tolist()
    return Identification(
        estimates, dict(zip(problem.replay.channels, spread, strict=True))
    )


class _Problem:
    """Residuals of a replay, and their derivatives.

    Attributes:
        replay: the replay.
        own: (p,) the vehicle's values.
        sought: p.
        least: (p + 4 pieces,) bounds of the unknowns.
        rows: number of measurements.
        noise: (channels,) standard deviations of what is measured.
    """

    def __init__(self, replay: Replay) -> None:
        self.replay = replay
        self.own = np.array([float(x) for x in replay.own])
        self.sought = len(self.own)
        least = (self.scaled("least") - self.own) / self.scaled("doubt")
        self.least = np.append(least, np.full(replay.starts.size, -np.inf))
        self._there = np.isfinite(replay.measured)
        self.rows = int(self._there.sum())
        self.noise = np.array([_NOISE[name] for name in replay.channels])
        self._last = (np.empty(0),) * 3

    def scaled(self, what: str, values: np.ndarray | None = None) -> np.ndarray:
        """A quantity (p,) of `PARAMETERS`, absolute: shares are of `own` by default."""
        of = self.own if values is None else values
        return np.where(_absolute(), 1.0, of) * [
            getattr(p, what) for p in PARAMETERS.values()
        ]

    def look(self, unknown: np.ndarray) -> np.ndarray:
        """Derivatives (rows, unknowns) at a point and, as last column, residuals.

        Triangles stand for the measurements, with the same squares and products.
        """
        p, s, n = self.sought, len(_START_STEPS), len(unknown)
        rows = [np.column_stack([np.eye(n), unknown])]
        for k, triangle in enumerate(self._triangles(unknown, self.noise)):
            part = np.zeros((len(triangle), n + 1))
            part[:, :p], part[:, -1] = triangle[:, :p], triangle[:, -1]
            part[:, p + s * k : p + s * (k + 1)] = triangle[:, p:-1]
            rows.append(part)
        return np.concatenate(rows)

    def _triangles(self, unknown: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Of each piece's derivatives and residuals (pieces, p + 5, p + 5), by QR."""
        residual, slope = self._simulated(unknown)
        both = np.append(slope, residual[None], axis=0) / noise[:, None]
        both, size = np.where(self._there, both, 0.0), len(both)
        piece = self.replay.recording.piece
        parts = (both[..., piece == k] for k in range(len(self.replay.starts)))
        rows = (
            np.append(x.reshape(size, -1).T, np.zeros((size, size)), 0) for x in parts
        )
        return np.array([np.linalg.qr(x, mode="r") for x in rows])

    def _simulated(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (channels, n) and their derivatives (p + 4, channels, n)."""
        if np.array_equal(unknown, self._last[0]):
            return self._last[1:]
        p, s = self.sought, len(_START_STEPS)
        steps = np.append(
            self.scaled("step") / self.scaled("doubt"), _START_STEPS / _START_DOUBTS
        )
        least = np.append(self.least[:p], np.full(s, -np.inf))
        sought = np.append(unknown[:p], np.zeros(s))
        up = np.diag(steps)
        down = np.diag(np.maximum(sought - steps, least) - sought)
        shifts = np.concatenate([np.zeros((1, p + s)), up, down])
        starts = unknown[p:].reshape(-1, s) + shifts[:, None, p:]
        seen = self.replay.simulate(
            self.own + self.scaled("doubt") * (unknown[:p] + shifts[:, :p]),
            self.replay.starts + _START_DOUBTS * starts,
        )
        residual = seen[0] - self.replay.measured
        if "yaw" in self.replay.channels:
            yaw = self.replay.channels.index("yaw")
            residual[yaw] = np.asarray(wrap_angle(residual[yaw]))
        apart = np.diag(up - down)[:, None, None]
        slope = (seen[1 : 1 + p + s] - seen[1 + p + s :]) / apart
        self._last = unknown.copy(), residual, slope
        return residual, slope

    def spread(self, unknown: np.ndarray) -> np.ndarray:
        """Standard deviations (channels,) of the residuals."""
        residual = np.where(self._there, self._simulated(unknown)[0], 0.0)
        # Numbers fitted, shared among the quantities.
        fitted = len(unknown) / len(residual)
        free = np.maximum(self._there.sum(axis=1) - fitted, 1)
        least = [_LEAST_NOISE * _NOISE[name] for name in self.replay.channels]
        return np.maximum(np.sqrt(np.sum(residual**2, axis=1) / free), least)

    def errors(self, unknown: np.ndarray) -> np.ndarray:
        """Half the 95 % intervals (p,), in units of the doubts."""
        p, pieces = self.sought, len(self.replay.starts)
        gradients, own = self._by_piece(unknown, self.noise)
        known = np.eye(p)
        total = own.sum(axis=0) + known
        moved = np.linalg.solve(total - own, gradients[..., None])[..., 0]
        jackknife = np.sqrt((pieces - 1) / pieces * np.sum(moved**2, axis=0))

        noise = self.noise * np.sqrt(self._redundancy(unknown))
        information = self._by_piece(unknown, noise)[1].sum(axis=0)
        size = np.sqrt(np.maximum(np.diag(information), 1e-300))
        values, vectors = np.linalg.eigh(information / np.outer(size, size))
        values[values < RANK] = 0.0
        information = (vectors * values) @ vectors.T * np.outer(size, size)
        fisher = np.sqrt(np.diag(np.linalg.inv(information + known)))
        within = student.ppf(0.975, max(pieces - 1, 1))
        return np.maximum(1.96 * fisher, within * jackknife)

    def _by_piece(
        self, unknown: np.ndarray, noise: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (pieces, p) and information (pieces, p, p) for the best starts."""
        triangles, p = self._triangles(unknown, noise), self.sought
        starts = unknown[p:].reshape(len(triangles), -1)
        square = np.einsum("kri,krj->kij", triangles, triangles)
        square[:, p:-1, p:-1] += np.eye(starts.shape[1])
        square[:, p:-1, -1] += starts
        across = np.linalg.solve(square[:, p:-1, p:-1], square[:, p:-1, :])
        left = square[:, :p] - square[:, :p, p:-1] @ across
        return left[..., -1], left[..., :p]

    def _redundancy(self, unknown: np.ndarray) -> np.ndarray:
        """Residuals (channels,) that tell as much as an independent one."""
        ratio = []
        for row, there in zip(self._simulated(unknown)[0], self._there, strict=True):
            row = row[there]
            r = np.sum(row[1:] * row[:-1]) / max(np.sum(row * row), 1e-300)
            ratio.append((1 + max(r, 0.0)) / max(1 - r, 1e-3))
        return np.array(ratio)


def _absolute() -> np.ndarray:
    return np.array([not p.relative for p in PARAMETERS.values()])
