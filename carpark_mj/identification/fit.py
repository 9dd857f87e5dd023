"""Least squares of a test drive: values, intervals, and what the log cannot tell.

The residuals are those of a simulation with the parameters sought and, of every piece
of the drive, its start. Levenberg-Marquardt minimises their squares, each over the
variance of its quantity, which is that of the residuals of the last fit. Derivatives
are central differences in float64; the starts are eliminated piece by piece.

The covariance of the parameters is the inverse of what the normal equations leave for
them without the starts (Fisher's information); combinations whose share of it is within
the precision of the derivatives have none. Where successive residuals of a quantity
correlate by r, its variance counts (1 + r) / (1 - r) times: errors of the model and
slow errors of sensors do not average out as white noise does.

The vehicle's own values count as measurements with wide errors (`Parameter.doubt`), so
that the intervals of the others include what an untold one may do to them.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from carpark_mj.geometry.se2 import wrap_angle
from carpark_mj.identification.log import DriveLog
from carpark_mj.identification.simulation import SIM_DT, Replay, Sought
from carpark_mj.vehicle.parameters import VehicleParameters

RANK = 1e-4  # eigenvalue of the scaled information that derivatives can make of none
QUANTILE = 1.96  # standard deviations, 95 % of a normal distribution


class Parameter(NamedTuple):
    """How one number is sought; shares of the vehicle's value where `relative`.

    Attributes:
        unit: its unit.
        relative: whether the others are shares.
        step: for derivatives, which moves events, such as the closing of the holding
            brake, by several substeps; less would take them for fixed.
        doubt: standard deviation of the vehicle's value.
        widest: half the longest interval with which the log tells it, a share of the
            value found.
        needs: what tells it in a drive.
    """

    unit: str
    relative: bool
    step: float
    doubt: float
    widest: float
    needs: str


PARAMETERS = {
    "steering_delay": Parameter(
        "s", False, 0.02, 0.3, 0.1, "steering to and fro at 1 m/s or more"
    ),
    "pedal_delay": Parameter(
        "s", False, 0.02, 0.3, 0.1, "a pedal pressed and released several times"
    ),
    "steering_ratio": Parameter(
        "", True, 1e-2, 0.5, 0.1, "small and large steering angles"
    ),
    "steering_offset": Parameter(
        "rad", False, 5e-3, 0.05, 0.01, "steering to both sides, or straight on"
    ),
    "cornering_stiffness": Parameter(
        "1/rad", True, 5e-2, 0.5, 0.25, "tight turns at 2.5 m/s or more"
    ),
    "max_acceleration": Parameter("m/s^2", True, 1e-2, 0.5, 0.1, "starts"),
    "max_deceleration": Parameter(
        "m/s^2", True, 1e-2, 0.5, 0.1, "braking from 1 m/s or more"
    ),
}
_LIMITS = 0.05, 20.0  # of what is relative
_START_STEPS = np.array([1e-2, 1e-2, 5e-3, 2e-2])  # m, m, rad, m/s
# The log's own guess of a start is at most some of these off.
_START_ERRORS = np.array([3.0, 3.0, 0.5, 1.0])  # m, m, rad, m/s
_START_LONGEST = _START_ERRORS / 5  # a step
# Of sensors, before residuals tell them.
_NOISE = {"x": 0.05, "y": 0.05, "yaw": 0.01, "speed": 0.05, "yaw_rate": 0.01}
_LEAST_NOISE = 1e-4  # of these
_ROUNDS, _ITERATIONS = 6, 40
_LONGEST = 2.0  # a step, in `Parameter.widest`
_ENOUGH = 0.1  # what the sum of squares falls by when it has converged


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
    fit = _Fit(Replay(log, params, ahead, sim_dt))
    fit.converge()
    errors = fit.errors()
    estimates = {
        name: Estimate(float(value if told else own), float(error), bool(told))
        for name, value, own, error, told in zip(
            Sought._fields,
            fit.sought,
            fit.own,
            errors,
            errors <= fit.scaled("widest", fit.sought),
            strict=True,
        )
    }
    spread = fit.spread().tolist()
    return Identification(
        estimates, dict(zip(fit.replay.channels, spread, strict=True))
    )


class _Normal(NamedTuple):
    """Sums of squares about a point: their value, gradient and curvature."""

    cost: float
    gradient: np.ndarray  # (p,)
    curvature: np.ndarray  # (p, p)
    mixed: np.ndarray  # (pieces, 4, p)
    start_gradient: np.ndarray  # (pieces, 4)
    start_curvature: np.ndarray  # (pieces, 4, 4)


class _Fit:
    """Levenberg-Marquardt on a replay.

    Attributes:
        replay: the replay.
        own: (p,) the vehicle's values.
        sought: (p,) the values.
        starts: (pieces, 4) the starts.
        noise: (channels,) standard deviations of what is measured.
    """

    def __init__(self, replay: Replay) -> None:
        self.replay = replay
        self.own = np.array([float(x) for x in replay.own])
        self.sought, self.starts = self.own.copy(), replay.starts.copy()
        self.noise = np.array([_NOISE[name] for name in replay.channels])
        self._residual, self._normal = self._look(self.sought, self.starts)

    def scaled(self, what: str, values: np.ndarray | None = None) -> np.ndarray:
        """A quantity (p,) of `PARAMETERS`, absolute: shares are of `own` by default."""
        relative = np.array([p.relative for p in PARAMETERS.values()])
        of = self.own if values is None else values
        return np.where(relative, of, 1.0) * [
            getattr(p, what) for p in PARAMETERS.values()
        ]

    def converge(self) -> None:
        """Fits until the noise of the quantities is that of their residuals."""
        for _ in range(_ROUNDS):
            self._minimise()
            before, self.noise = self.noise, self.spread()
            self._residual, self._normal = self._look(self.sought, self.starts)
            if np.abs(np.log(self.noise / before)).max() < 0.02:
                break

    def spread(self) -> np.ndarray:
        """Standard deviations (channels,) of the residuals."""
        found = np.isfinite(self._residual)
        counts = found.sum(axis=1)
        # Numbers fitted, shared among the quantities.
        fitted = (self.sought.size + self.starts.size) / len(counts)
        squares = np.nansum(self._residual**2, axis=1)
        least = [_LEAST_NOISE * _NOISE[name] for name in self.replay.channels]
        return np.maximum(np.sqrt(squares / np.maximum(counts - fitted, 1)), least)

    def errors(self) -> np.ndarray:
        """Half the 95 % intervals (p,)."""
        noise = self.noise
        self.noise = noise * np.sqrt(self._redundancy())
        _, normal = self._look(self.sought, self.starts)
        self.noise = noise
        _, curvature, _ = _without_starts(normal, 0.0)
        known = np.diag(self.scaled("doubt") ** -2.0)
        information = curvature - known
        size = np.sqrt(np.maximum(np.diag(information), 1e-300))
        values, vectors = np.linalg.eigh(information / np.outer(size, size))
        values[values < RANK] = 0.0
        information = (vectors * values) @ vectors.T * np.outer(size, size)
        return QUANTILE * np.sqrt(np.diag(np.linalg.inv(information + known)))

    def _redundancy(self) -> np.ndarray:
        """Residuals (channels,) that tell as much as an independent one."""
        ratio = []
        for row in self._residual:
            row = row[np.isfinite(row)]
            r = np.sum(row[1:] * row[:-1]) / max(np.sum(row * row), 1e-300)
            ratio.append((1 + max(r, 0.0)) / max(1 - r, 1e-3))
        return np.array(ratio)

    def _minimise(self) -> None:
        damping, relative = 1e-3, np.array([p.relative for p in PARAMETERS.values()])
        for _ in range(_ITERATIONS):
            longest = _LONGEST * self.scaled("widest")
            change, start_change = _step(self._normal, damping, longest)
            sought = self.sought + change
            within = np.clip(sought, *np.outer(_LIMITS, self.own))
            sought = np.where(relative, within, sought)
            starts = self.starts + start_change
            residual, normal = self._look(sought, starts)
            gain = self._normal.cost - normal.cost
            if gain > 0:
                self.sought, self.starts = sought, starts
                self._residual, self._normal = residual, normal
                damping = max(damping / 10, 1e-9)
            else:
                damping *= 10
            if damping > 1e3 or 0 <= gain < _ENOUGH:
                break

    def _look(
        self, sought: np.ndarray, starts: np.ndarray
    ) -> tuple[np.ndarray, _Normal]:
        """Residuals (channels, n) at a point, and the sums of their squares."""
        p, s = len(sought), starts.shape[-1]
        own_steps = self.scaled("step")
        moved = np.concatenate([np.diag(own_steps), np.zeros((s, p))])
        moved_starts = np.concatenate([np.zeros((p, s)), np.diag(_START_STEPS)])
        shifts = np.concatenate([np.zeros((1, p)), moved, -moved])
        start_shifts = np.concatenate([np.zeros((1, s)), moved_starts, -moved_starts])
        seen = self.replay.simulate(sought + shifts, starts + start_shifts[:, None])
        residual = seen[0] - self.replay.measured
        if "yaw" in self.replay.channels:
            yaw = self.replay.channels.index("yaw")
            residual[yaw] = np.asarray(wrap_angle(residual[yaw]))
        steps = np.concatenate([own_steps, _START_STEPS])[:, None, None]
        slope = (seen[1 : 1 + p + s] - seen[1 + p + s :]) / (2 * steps)
        weight = np.where(np.isfinite(residual), 1 / self.noise[:, None], 0.0)
        normal = self._sums(
            np.nan_to_num(residual) * weight, slope * weight, sought, starts
        )
        return residual, normal

    def _sums(
        self,
        residual: np.ndarray,
        slope: np.ndarray,
        sought: np.ndarray,
        starts: np.ndarray,
    ) -> _Normal:
        """Sums of squares of weighted residuals and of what is known before."""
        p, piece = len(sought), self.replay.recording.piece
        off = (sought - self.own) / self.scaled("doubt")
        start_off = (starts - self.replay.starts) / _START_ERRORS
        by_sought, by_start = slope[:p], slope[p:]
        mixed, gradient, curvature = [], [], []
        for k in range(len(starts)):
            rows = piece == k
            mine = by_start[..., rows].reshape(len(by_start), -1)
            theirs = by_sought[..., rows].reshape(p, -1)
            mixed.append(mine @ theirs.T)
            gradient.append(mine @ residual[:, rows].ravel())
            curvature.append(mine @ mine.T + np.diag(_START_ERRORS**-2.0))
        flat = by_sought.reshape(p, -1)
        return _Normal(
            float(sum(np.sum(part**2) for part in (residual, off, start_off))),
            flat @ residual.ravel() + off / self.scaled("doubt"),
            flat @ flat.T + np.diag(self.scaled("doubt") ** -2.0),
            np.array(mixed),
            np.array(gradient) + start_off / _START_ERRORS,
            np.array(curvature),
        )


def _without_starts(
    normal: _Normal, damping: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gradient and curvature for the best starts; damped inverses of the starts'."""
    diagonal = np.einsum("kii->ki", normal.start_curvature)
    damped = normal.start_curvature + damping * diagonal[..., None] * np.eye(4)
    inverse = np.linalg.inv(damped)
    across = np.einsum("kij,kip,kjq->pq", inverse, normal.mixed, normal.mixed)
    pull = np.einsum("kij,kip,kj->p", inverse, normal.mixed, normal.start_gradient)
    return normal.gradient - pull, normal.curvature - across, inverse


def _step(
    normal: _Normal, damping: float, longest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The damped step of the numbers sought (p,) and of the starts (pieces, 4)."""
    gradient, curvature, inverse = _without_starts(normal, damping)
    damped = curvature + damping * np.diag(np.diag(normal.curvature))
    change = -np.linalg.solve(damped, gradient)
    change /= max(1.0, np.max(np.abs(change) / longest))
    pull = normal.start_gradient + normal.mixed @ change
    moved = -np.einsum("kij,kj->ki", inverse, pull)
    return change, np.clip(moved, -_START_LONGEST, _START_LONGEST)
