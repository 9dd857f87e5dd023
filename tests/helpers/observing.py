"""Observations of scenes by hand."""

import math

import jax
import jax.numpy as jnp
from helpers.scenes import fields_of, lot
from helpers.states import config_of, parked_in, state_of

from carpark_mj.config import RayConfig, RingConfig
from carpark_mj.observations import ContinuousObservation, observation_size, observe

CONFIGS = [
    ContinuousObservation(),
    ContinuousObservation(0, 0, rings=RingConfig()),
    ContinuousObservation(5, 1, rings=RingConfig((4.5,), cap=3)),
    ContinuousObservation(0, 4, rings=RingConfig((3.0, 7.25))),
    ContinuousObservation(rays=RayConfig(5), own_car=True, lines=True),
]

observe_jit = jax.jit(observe, static_argnums=0)


def observed(config, layout, motion, goal, parked_bay=(), parked_size=(4.0, 2.0)):
    """Named fields of all agents."""
    config = config_of(config)
    state = state_of(
        layout, motion, goal, parked_cars=parked_in(layout, parked_bay, parked_size)
    )
    observation = observe_jit(config, state)
    assert observation.shape == (motion.size.shape[0], observation_size(config))
    assert observation.dtype == jnp.float32
    return fields_of(observation, config)


# Bays of 6 m x 3 m; the scene below is worked out by hand.
BAYS = lot([(10.0, 5.0, math.pi / 2), (-4.0, 0.0, 0.0), (2.0, 2.0, 0.0), (2.0, 9.0, 0)])
