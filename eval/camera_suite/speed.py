"""Pictures a second: cameras, the view from above, and MuJoCo's renderer.

On a CPU a second is one of a core, of all threads together, which other work on the
machine disturbs far less; on a GPU it is one of the wall clock.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from camera_suite.lots import environment
from carpark_mj import ParkingEnv
from carpark_mj.benchmarking.worker import CLOCKS, best_time
from carpark_mj.cameras import (
    RIGS,
    BirdsEye,
    Heights,
    Pictures,
    Rig,
    see,
    see_from_above,
)
from carpark_mj.cameras.encoder import CameraObservation

REPEATS = 5


@dataclasses.dataclass(frozen=True)
class Speed:
    """A row of the table.

    Attributes:
        what: is drawn.
        lots: at once, with one agent each.
        rate: of them [1/s].
        pixels: of the pictures of an agent.
        memory: of the program, the pictures included [GiB].
    """

    what: str
    lots: int
    rate: float
    pixels: int
    memory: float = 0.0


def speeds(layout: str, batches: Sequence[int], draws: bool) -> Iterator[Speed]:
    """Rows of a table.

    Args:
        layout: of the lots.
        batches: numbers of lots.
        draws: whether MuJoCo can draw.
    """
    blind = environment(layout, people=False, agents=1)
    env = ParkingEnv(dataclasses.replace(blind.config, observation=CameraObservation()))
    still = jnp.zeros((env.num_agents, env.action_spec.size))
    rig, heights, above = RIGS["surround"], Heights.of(env.fleet), BirdsEye()
    cameras = len(rig.cameras) * rig.width * rig.height
    looks: list[tuple[str, int, Callable[[Any], Any]]] = [
        ("surround", cameras, lambda state: _drawn(see(rig, state, heights))),
        ("surround, classes only", cameras, lambda s: see(rig, s, heights).seen),
        ("bird's eye", above.pixels**2, lambda s: see_from_above(above, s)),
        ("step with surround", cameras, lambda s: env.step(s, still)[1].observation),
    ]
    reset = jax.jit(jax.vmap(lambda key: env.reset(key)[0]))
    states = None
    for lots in batches:
        states = reset(jax.random.split(jax.random.key(0), lots))
        for what, pixels, look in looks:
            rate, memory = _lots(look, states, lots)
            yield Speed(what, lots, rate, pixels, memory)
    if draws and states is not None:
        first = jax.tree.map(lambda x: x[0], states)
        yield Speed(
            "MuJoCo's renderer", 1, 1 / _mujoco_seconds(env, first, rig), cameras
        )


def _drawn(pictures: Pictures) -> tuple[jax.Array, jax.Array]:
    """Depth and classes, as MuJoCo draws them."""
    return pictures.depth, pictures.seen


def _lots(look: Callable[[Any], Any], states: Any, lots: int) -> tuple[float, float]:
    """Lots a second and GiB: all at once on a GPU, one after the other on a CPU."""
    on_cpu = jax.default_backend() == "cpu"
    looked = (lambda s: jax.lax.map(look, s)) if on_cpu else jax.vmap(look)
    run = jax.jit(looked).lower(states).compile()
    used: Any = run.memory_analysis()
    memory = used.temp_size_in_bytes + used.output_size_in_bytes
    jax.block_until_ready(run(states))
    return lots / best_time(lambda: run(states), REPEATS, _clock()), memory / 2**30


def _clock() -> Callable[[], float]:
    return CLOCKS["cpu" if jax.default_backend() == "cpu" else "wall"]


def _mujoco_seconds(env: ParkingEnv, state: Any, rig: Rig) -> float:
    """Seconds in which MuJoCo draws depth and segmentation of as many pictures."""
    import mujoco

    from camera_suite.reference import BlockStage

    stage = BlockStage(
        jax.device_get(state.layout),
        env.vehicle,
        env.config.num_agents,
        env.config.num_parked_cars,
    )
    state = jax.device_get(state)
    stage.place(state.motion.pose_w, state.motion.steering, state.parked_cars.pose_w)
    renderer = mujoco.Renderer(stage.model, rig.height, rig.width)

    def draw() -> None:
        for _ in rig.cameras:
            renderer.update_scene(stage.data, camera="agent0/driver")
            renderer.enable_depth_rendering()
            renderer.render()
            renderer.disable_depth_rendering()
            renderer.enable_segmentation_rendering()
            renderer.render()
            renderer.disable_segmentation_rendering()

    draw()
    seconds = best_time(draw, REPEATS, _clock())
    renderer.close()
    return seconds
