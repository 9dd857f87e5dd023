"""How far pictures agree with MuJoCo's of the same state."""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np

from camera_suite.lots import environment
from camera_suite.reference import Reference, Renderer
from carpark_mj import ParkingEnv
from carpark_mj.cameras import RIGS, Heights, Pictures, Rig, see
from carpark_mj.types import State

CLOSE = 0.01  # m, of depths that agree
ENOUGH = 0.995  # share of the pixels
RIG_NAMES = ("surround", "windscreen")


@dataclasses.dataclass
class Agreement:
    """Counts of pixels.

    Attributes:
        pixels: all.
        on_edge: where things meet within a quarter of a pixel or so.
        close: off the edges, with the right depth.
        same: of the right class.
        same_meshes: of the same class as where MuJoCo draws the cars' meshes.
    """

    pixels: int = 0
    on_edge: int = 0
    close: int = 0
    same: int = 0
    same_meshes: int = 0

    @property
    def depth(self) -> float:
        """Share of the pixels off edges whose depth agrees."""
        return self.close / max(self.pixels - self.on_edge, 1)

    @property
    def classes(self) -> float:
        """Share of the pixels whose class agrees."""
        return self.same / self.pixels

    @property
    def meshes(self) -> float:
        """The same where MuJoCo draws meshes."""
        return self.same_meshes / self.pixels

    def add(self, rig: Rig, pictures: Pictures, reference: Reference) -> None:
        """Counts the pictures (cameras, height, width) of a car."""
        depth, seen = np.asarray(pictures.depth), np.asarray(pictures.seen)
        off = np.abs(depth - np.minimum(reference.depth, rig.reach))
        self.pixels += seen.size
        self.on_edge += int(reference.on_edge.sum())
        self.close += int(((off < CLOSE) & ~reference.on_edge).sum())
        self.same += int((seen == reference.seen).sum())


def compare(env: ParkingEnv, states: Sequence[State], meshes: bool = True) -> Agreement:
    """Compares the pictures of all agents in some lots.

    Args:
        env: the environment.
        states: of its lots.
        meshes: compare with meshes, too.
    """
    heights, total = Heights.of(env.fleet), Agreement()
    pictures_of = jax.jit(see, static_argnums=(0, 2))
    for state in states:
        drawn = [
            Renderer(env, state, meshes=each) for each in (False, True)[: 1 + meshes]
        ]
        for name in RIG_NAMES:
            rig = RIGS[name]
            pictures = pictures_of(rig, state, heights)
            for agent in range(env.config.num_agents):
                own = jax.tree.map(lambda x: x[agent], pictures)  # noqa: B023
                total.add(rig, own, drawn[0].show(rig, agent))
                for renderer in drawn[1:]:
                    other = renderer.show(rig, agent).seen
                    total.same_meshes += int((np.asarray(own.seen) == other).sum())
        for renderer in drawn:
            renderer.close()
    return total


def compare_layout(layout: str, lots: int) -> Agreement:
    """Compares the pictures in some lots of a layout."""
    env = environment(layout)
    reset = jax.jit(lambda key: env.reset(key)[0])
    return compare(env, [reset(jax.random.key(seed)) for seed in range(lots)])
