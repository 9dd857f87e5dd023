"""Jobs and results of measuring processes."""

import dataclasses
from typing import Literal

What = Literal["env", "ppo", "physics"]
Clock = Literal["wall", "cpu"]


@dataclasses.dataclass(frozen=True)
class Job:
    """The measurement of one process.

    Attributes:
        what: environment steps, whole PPO updates, or the physics alone.
        variant: layout of `env`, preset of `ppo`, tyres or stepper of
            `physics`.
        lots: simulated at once; for `physics`, cars.
        num_agents: in each lot of `env`; `ppo` and `physics` have their own.
        num_parked_cars: in each lot of `env`.
        steps: control steps per timing; `ppo` times updates instead.
        timings: of which the best counts.
        clock: by which they are taken.
        runs: of `ppo`, side by side in one program.
    """

    what: What
    variant: str
    lots: int
    num_agents: int
    num_parked_cars: int
    steps: int
    timings: int
    clock: Clock
    runs: int = 1


@dataclasses.dataclass(frozen=True)
class Measurement:
    """Results of a process; columns of the CSV after those of the checkout.

    Attributes:
        device: the GPU's name, or the number of CPU cores.
        jax: version.
        mujoco: version.
        what: measured, with the preset and runs of `ppo` or the tyres and substep of
            `physics`.
        layout: of the lots; empty for `physics`.
        agents: in each lot.
        lots: simulated at once.
        rate: units per second of the clock.
        unit: counted unit, per second of which clock.
        compile_s: tracing, lowering and compiling the program [s of the clock].
        first_step_s: from the start of the process to that of the first call [s of the
            clock].
        peak_memory_mb: of the first GPU, or of the process on a CPU [1e6 bytes].
    """

    device: str
    jax: str
    mujoco: str
    what: str
    layout: str
    agents: int
    lots: int
    rate: float
    unit: str
    compile_s: float
    first_step_s: float
    peak_memory_mb: float
