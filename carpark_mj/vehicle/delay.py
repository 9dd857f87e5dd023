"""Dead time between a command and the actuator that obeys it.

Steering and pedal have lines of their own, on which commands travel for a whole number
of substeps. A line exists only where there is a delay. All functions are elementwise,
for cars of any shape.
"""

import dataclasses
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import SimConfig


@struct.dataclass
class Line:
    """Commands of one control on their way to cars (...).

    Attributes:
        sent: values (...), the newest first. The last acts now, the one before it next.
        wait: (...) time until that one arrives [s].
    """

    sent: tuple[jax.Array, ...]
    wait: jax.Array


class Lines(NamedTuple):
    """The lines of steering and pedal; None where commands arrive at once."""

    steer: Line | None
    pedal: Line | None


def make_lines(sim: SimConfig, like: jax.Array) -> Lines:
    """Lines on which zeros travel, for cars of the shape of `like`."""
    zero = jnp.zeros_like(like)

    def line(delay: float) -> Line | None:
        count = _whole_steps(sim, delay) + 2
        return Line((zero,) * count, zero) if delay else None

    return Lines(line(sim.steering_delay), line(sim.pedal_delay))


def send(sim: SimConfig, lines: Lines, controls: jax.Array) -> Lines:
    """The lines at the start of a control step with its controls (..., 2)."""

    def sent(line: Line | None, command: jax.Array, delay: float) -> Line | None:
        if line is None:
            return None
        wait = delay - _whole_steps(sim, delay) * sim.ctrl_dt
        return Line((command, *line.sent[:-1]), jnp.full_like(line.wait, wait))

    return Lines(
        sent(lines.steer, controls[..., 0], sim.steering_delay),
        sent(lines.pedal, controls[..., 1], sim.pedal_delay),
    )


def receive(
    lines: Lines,
    controls: tuple[jax.Array, jax.Array],
    dt: float | jax.Array,
) -> tuple[Lines, tuple[jax.Array, jax.Array]]:
    """What arrives in a substep.

    Args:
        lines: at its start.
        controls: steer and pedal (...) of the control step.
        dt: substep [s].

    Returns:
        The lines at its end, and the steer and pedal (...) that act during it.
    """
    after: list[Line | None] = []
    arrived: list[jax.Array] = []
    for line, control in zip(lines, controls, strict=True):
        if line is not None:
            early = line.wait > dt / 2
            control = jnp.where(early, line.sent[-1], line.sent[-2])
            line = dataclasses.replace(line, wait=line.wait - dt)
        after.append(line)
        arrived.append(control)
    return Lines(*after), (arrived[0], arrived[1])


def _whole_steps(sim: SimConfig, delay: float) -> int:
    """Control steps that end before a command of a step acts."""
    return math.ceil(delay / sim.ctrl_dt - 1e-6) - 1
