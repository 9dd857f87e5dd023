"""A video of a trained policy at the junction."""

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.rendering.renderer import RenderingError
from carpark_papers.cederle.junction import actions
from carpark_papers.cederle.junction.evaluation import evaluation_env
from carpark_papers.cederle.rendering.video import ENDS, Drive, write_drives
from carpark_papers.cederle.training.config import JunctionRunConfig

Act = Callable[
    [jax.Array], jax.Array
]  # observations (episodes, agents, ...) to actions


def write_video(folder: Path, config: JunctionRunConfig, act: Act) -> None:
    """Writes `video.mp4` with the first episodes of an evaluation, if there is GL."""
    if not config.video_episodes:
        return
    drives = record(config, act)
    try:
        print(f"wrote {write_drives(folder / 'video.mp4', config.junction, drives)}")
    except RenderingError as error:
        print(f"no video: {error}", file=sys.stderr)


def record(config: JunctionRunConfig, act: Act) -> list[Drive]:
    """The first `video_episodes` episodes of an evaluation, till all have ended."""
    env = evaluation_env(config.junction, config.eval_jitter)
    keys = config.evaluation_keys()[: config.video_episodes]
    state, observation = jax.jit(jax.vmap(env.reset))(keys)
    step = jax.jit(jax.vmap(env.step))
    ended = jnp.zeros((len(keys), env.num_agents, len(ENDS)), bool)
    drives: list[tuple[list[Any], ...]] = [([], [], []) for _ in keys]
    for _ in range(env.config.max_steps):
        running = np.asarray(state.active.any(axis=1))
        if not running.any():
            break
        action = act(observation)
        state, timestep = step(state, action)
        observation = timestep.observation
        ended |= jnp.stack([getattr(timestep.events, name) for name in ENDS], axis=-1)
        index = jax.vmap(lambda a: actions.parse(env.action_spec, a))(action)
        bare = dataclasses.replace(state, frames=None)
        seen = jax.device_get((bare, index, ended))
        for k in np.flatnonzero(running):
            for values, value in zip(drives[k], seen, strict=True):
                values.append(jax.tree.map(lambda x, k=k: x[k], value))
    return [Drive(*drive) for drive in drives]
