"""Cars that drive alone by a schedule, every substep recorded."""

import dataclasses
import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from helpers.compiling import optimized_jit

from carpark_mj.config import SimConfig
from carpark_mj.physics.mjx import CarState, MjxPhysics
from carpark_mj.vehicle import COMPACT, Vehicle, VehicleParameters, make_vehicle

DT = 0.01
NUM_STEPS = 1200  # 12 s
NUM_CARS = 64  # every recorded batch has this size, so that one program serves all
ORIGIN = (0.0, 0.0, 0.0)
ELSEWHERE = (12.0, -7.0, 2.5)

Segment = tuple[float, float, float]  # duration [s], steer, pedal
HOLD: Segment = (12.0, 0.0, 0.0)
WANDER: list[Segment] = [
    (1.0, 0.7, 1.0),
    (1.0, -0.9, 0.6),
    (0.6, 0.2, -1.0),
    (1.5, -0.5, -0.7),
    (0.7, 1.0, 0.3),
    (1.0, 1.0, 0.8),
    HOLD,
]
# Standing, pulling away, cruising and stopping, both ways.
STOP_AND_GO: list[Segment] = [
    (1.0, 0.0, 0.0),
    (3.0, 0.0, 1.0),
    (0.7, 0.0, -1.0),
    (1.5, 0.0, 0.0),
    (3.0, 0.0, -1.0),
    (0.45, 0.0, 1.0),
    HOLD,
]
VAN = dataclasses.replace(
    COMPACT,
    wheelbase=3.2,
    length=5.2,
    mass=2100.0,
    cg_to_front_axle=1.5,
    cg_height=0.75,
    roll_inertia=1000.0,
    pitch_inertia=4300.0,
    yaw_inertia=4600.0,
    front_drive=0.0,
    tyre=dataclasses.replace(COMPACT.tyre, friction=0.7),
)
WHEEL_INERTIAS = (0.4, 0.5, 1.0, 2.0)  # kg m^2
STIFFENINGS = (0.5, 1.0, 1.5, 2.0)  # of the slip stiffness


@dataclasses.dataclass(frozen=True)
class Drive:
    """A car, its start and what its driver does."""

    params: VehicleParameters
    start: tuple[float, float, float]
    segments: list[Segment]

    def controls(self) -> np.ndarray:
        """(NUM_STEPS, 2), the last segment cut off where time is up."""
        rows = [np.tile(s[1:], (round(s[0] / DT), 1)) for s in self.segments]
        return np.concatenate(rows)[:NUM_STEPS].astype(np.float32)


@dataclasses.dataclass(frozen=True)
class Track:
    """What a car did: arrays over the substeps of its drive."""

    pose: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray
    height: np.ndarray
    finite: np.ndarray

    @property
    def speed(self) -> np.ndarray:
        return self.velocity[:, 0]


def with_wheels(inertia: float, stiffer: float) -> VehicleParameters:
    tyre = dataclasses.replace(
        COMPACT.tyre, slip_stiffness=stiffer * COMPACT.tyre.slip_stiffness
    )
    return dataclasses.replace(
        COMPACT, wheel_inertia=inertia, wheel_tilt_inertia=1.0, tyre=tyre
    )


def all_drives() -> dict[object, Drive]:
    drives: dict[object, Drive] = {
        "stand": Drive(COMPACT, ORIGIN, [HOLD]),
        "full speed": Drive(COMPACT, ORIGIN, [(12, 0, 1)]),
        "full reverse": Drive(COMPACT, ORIGIN, [(12, 0, -1)]),
        "wander": Drive(COMPACT, ORIGIN, WANDER),
        "wander elsewhere": Drive(COMPACT, ELSEWHERE, WANDER),
        "wander mirrored": Drive(COMPACT, ORIGIN, [(d, -s, p) for d, s, p in WANDER]),
        "wander in a van": Drive(VAN, ORIGIN, WANDER),
    }
    for inertia, stiffer in itertools.product(WHEEL_INERTIAS, STIFFENINGS):
        drives["wheels", inertia, stiffer] = Drive(
            with_wheels(inertia, stiffer), ORIGIN, STOP_AND_GO
        )
    return drives


DRIVES = all_drives()


def stack(vehicles: list[Vehicle]) -> Vehicle:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *vehicles)


def make_recorder(sim: SimConfig) -> Callable[[list[Drive]], list[Track]]:
    """Compiles a program that drives up to NUM_CARS cars and records every substep."""
    physics = MjxPhysics(dataclasses.replace(sim, sim_dt=DT, ctrl_dt=DT, trace_dt=DT))

    @optimized_jit
    def run(poses: jax.Array, vehicles: Vehicle, controls: jax.Array) -> Track:
        def step(state: CarState, control: jax.Array):
            state = physics.step(state, control)
            seen = physics.read(state)
            spin = state.qvel[:, physics.index.spin_dof]
            height = state.qpos[:, physics.index.root_qpos + 2]
            return state, (seen.pose_w, seen.velocity_b, spin, height, seen.finite)

        return jax.lax.scan(step, physics.init(poses, vehicles), controls)[1]

    def record(drives: list[Drive]) -> list[Track]:
        cars = drives + [drives[-1]] * (NUM_CARS - len(drives))
        made = {params: make_vehicle(params) for params in {d.params for d in cars}}
        arrays = run(
            jnp.array([d.start for d in cars], jnp.float32),
            stack([made[d.params] for d in cars]),
            jnp.stack([d.controls() for d in cars], axis=1),
        )
        arrays = [np.asarray(a) for a in arrays]
        return [Track(*(a[:, i] for a in arrays)) for i in range(len(drives))]

    return record
