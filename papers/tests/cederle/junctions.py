"""Junctions by hand."""

import dataclasses
import functools

import jax
import jax.numpy as jnp

from carpark_papers.cederle.junction import JunctionConfig, JunctionEnv


@functools.lru_cache
def env(**settings):
    return JunctionEnv(JunctionConfig(**{"respawn": False, **settings}))


@functools.lru_cache
def programs(env):
    return jax.jit(env.reset), jax.jit(env.step)


def begin(env, seed=0):
    return programs(env)[0](jax.random.key(seed))[0]


def drive(env, state, policy, steps):
    """Steps with `policy(k)` as actions; returns states and time steps of each."""
    seen = []
    for k in range(steps):
        state, timestep = programs(env)[1](state, jnp.asarray(policy(k)))
        seen.append((state, timestep))
        if timestep.over:
            break
    return seen


def with_poses(state, pose_w):
    """The state with all cars standing at other poses (cars, 3)."""
    pose_w = jnp.asarray(pose_w, jnp.float32)
    trace = jnp.broadcast_to(pose_w[:, None], state.motion.trace_w.shape)
    motion = dataclasses.replace(state.motion, pose_w=pose_w, trace_w=trace)
    return dataclasses.replace(state, motion=motion)
