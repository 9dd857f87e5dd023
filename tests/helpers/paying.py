"""Steps of cars that drive as `LIMITS` let them, and what they are paid for them."""

import jax.numpy as jnp
import numpy as np
from helpers.scenes import lot
from helpers.states import HandPhysics, hand_cars
from helpers.transitions import no_events, transition

from carpark_mj.config import EnvConfig
from carpark_mj.mdp.rewards import reward_terms, term_weights

MAX_STEPS = 200
LIMITS = {"max_speed": 3.0, "max_reverse_speed": 2.0, "steering_rate": 0.42}
GOAL = (10.0, 0.0, 0.0)
LOT = lot([(0.0, 0.0, 0.0)])


def events(count, **true):
    """Events of some agents; each keyword lists the agents it holds for."""
    flags = {name: np.isin(np.arange(count), who) for name, who in true.items()}
    return no_events(count, **flags)


def step(config, before, after, goal=GOAL, happened=None, **more):
    """A step of cars that drive as `LIMITS` let them."""
    count = before.yaw_rate.shape[0]
    goal = jnp.asarray(np.broadcast_to(np.asarray(goal, np.float32), (count, 3)))
    physics = HandPhysics(hand_cars(before, **LIMITS))
    return transition(
        config,
        LOT,
        before,
        after,
        {"physics": physics},
        target_pose=goal,
        events=events(count) if happened is None else happened,
        **more,
    )


def terms(reward, before, after, goal, happened=None):
    count = before.yaw_rate.shape[0]
    config = EnvConfig(num_agents=count, reward=reward)
    assert config.episode.max_steps == MAX_STEPS
    named = reward_terms(config, step(config, before, after, goal, happened))
    assert tuple(named) == tuple(term_weights(config))
    return {name: np.asarray(term, np.float64) for name, term in named.items()}
