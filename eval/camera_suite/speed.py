"""Pictures a second: cameras, the view from above, and MuJoCo's renderer.

On a CPU a second is one of a core, of all threads together, which other work on the
machine disturbs far less; on a GPU it is one of the wall clock.
"""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import mujoco

from camera_suite.lots import environment
from camera_suite.reference import BlockStage
from carpark_mj import ParkingEnv
from carpark_mj.benchmarking.timing import CLOCKS, best_time
from carpark_mj.cameras import RIGS, BirdsEye, Heights, Rig, see, see_from_above

REPEATS = 5
Row = dict[str, str | float]


def speeds(layout: str, batch: int) -> Iterator[Row]:
    """Rows of a table: what, pixels/s and agent steps/s.

    Args:
        layout: of the lots, with one agent each.
        batch: number of lots.
    """
    env = environment(layout, people=False, agents=1)
    rig, heights, above = RIGS["surround"], Heights.of(env.fleet), BirdsEye()
    keys = jax.random.split(jax.random.key(0), batch)
    states = jax.jit(jax.vmap(lambda key: env.reset(key)[0]))(keys)
    cameras = len(rig.cameras) * rig.width * rig.height
    yield _row(
        "surround", cameras, _lots(lambda s: see(rig, s, heights), states, batch)
    )
    seen = _lots(lambda s: see(rig, s, heights).seen, states, batch)
    yield _row("surround, classes only", cameras, seen)
    pixels = above.pixels**2
    yield _row(
        "bird's eye", pixels, _lots(lambda s: see_from_above(above, s), states, batch)
    )
    first = jax.tree.map(lambda x: x[0], states)
    yield _row("MuJoCo's renderer", cameras, 1 / _mujoco_seconds(env, first, rig))


def _row(what: str, pixels: int, rate: float) -> Row:
    return {"what": what, "pixels/s": pixels * rate, "agent steps/s": rate}


def _lots(look: Callable[[Any], Any], states: Any, batch: int) -> float:
    """Lots a second: all at once on a GPU, one after the other on a CPU."""
    if jax.default_backend() == "cpu":
        run = jax.jit(lambda states: jax.lax.map(look, states))
    else:
        run = jax.jit(jax.vmap(look))
    jax.block_until_ready(run(states))
    return batch / best_time(lambda: run(states), REPEATS, _clock())


def _clock() -> Callable[[], float]:
    return CLOCKS["cpu" if jax.default_backend() == "cpu" else "wall"]


def _mujoco_seconds(env: ParkingEnv, state: Any, rig: Rig) -> float:
    """Seconds in which MuJoCo draws depth and segmentation of as many pictures."""
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
