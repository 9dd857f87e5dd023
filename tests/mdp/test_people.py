"""Reward terms and metrics about people, by hand."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import pytest
from helpers.scenes import cars, lot
from helpers.transitions import no_events, no_terms, transition

from carpark_mj.config import EnvConfig, MetricsConfig, RewardConfig
from carpark_mj.geometry.obstacles import Discs, Movers, ObstacleKind
from carpark_mj.mdp.metrics import init_stats, update_stats
from carpark_mj.mdp.people import HARD_BRAKING
from carpark_mj.mdp.rewards import reward_terms

LOT = lot([(30.0, 0.0, 0.0)])
RADIUS = 0.3
METRICS = tuple(MetricsConfig.everything().extra)
CONFIG = EnvConfig(
    num_agents=1,
    movers=("pedestrians:number=1",),
    reward=RewardConfig(extra={"person": 10.0, "comfort": 1.0}),
    metrics=MetricsConfig(extra=METRICS),
)


def person(gap, speed=0.0):
    """A person so far before the bumper of a car of 4 m at the origin."""
    xy, away = jnp.array([[2.0 + gap + RADIUS, 0.0]]), jnp.array([[speed, 0.0]])
    return Movers(
        (), ((Discs(xy, jnp.array([RADIUS]), away, kind=ObstacleKind.PERSON),),)
    )


def made(was, now, stats=None, hit=False):
    """A step between two gaps [m] and own speeds [m/s]."""
    pose = [(0.0, 0.0, 0.0)]
    before, after = (cars(pose, speed=speed) for _, speed in (was, now))
    events = no_events(1, crashed=[hit], hit_person=[hit])
    step = transition(CONFIG, LOT, before, after, events=events)
    stats = step.before.stats if stats is None else stats
    return dataclasses.replace(
        step,
        before=dataclasses.replace(step.before, movers=person(was[0]), stats=stats),
        after=dataclasses.replace(step.after, movers=person(now[0])),
    )


@jax.jit
def update(step):
    return update_stats(CONFIG, step, no_terms(CONFIG))


def episode(*instants, hit=False):
    """Tallies of an episode through gaps and speeds."""
    stats = init_stats(CONFIG, LOT)
    for k, (was, now) in enumerate(itertools.pairwise(instants)):
        last = k == len(instants) - 2
        step = made(was, now, stats, hit and last)
        stats = update(step)
    return {name: float(stats.tallies[name][0]) for name in METRICS}


def test_a_contact_costs_more_and_passing_close_costs_by_speed():
    terms = reward_terms(CONFIG, made((0.5, 2.0), (0.0, 1.0), hit=True))
    assert terms["person"] == pytest.approx(-10.0)
    terms = reward_terms(CONFIG, made((5.0, 3.0), (1.0, 3.0)))
    # Half of the 2 m are missing at 3 m/s, of a weight for the whole episode.
    cost = 1.5**2 / CONFIG.episode.max_steps
    assert float(terms["comfort"][0]) == pytest.approx(-cost)
    assert terms["person"] == 0.0
    far = reward_terms(CONFIG, made((5.0, 2.0), (2.1, 3.0)))
    assert far["comfort"] == 0.0


def test_a_near_miss_is_counted_once_when_it_begins():
    # At 2 m/s the time to a person 4 m ahead is 2 s, to one 2 m ahead 1 s.
    assert episode((4.0, 2.0), (2.0, 2.0), (1.8, 2.0))["near_misses"] == 1
    assert episode((4.0, 2.0), (2.0, 2.0), (4.0, 0.0), (2.0, 2.0))["near_misses"] == 2
    assert episode((9.0, 0.0), (0.4, 0.0), (0.4, 0.1))["near_misses"] == 0
    assert episode((9.0, -2.0), (0.4, -2.0))["near_misses"] == 1  # close and fast


def test_the_least_gap_comes_with_the_speed_at_it():
    found = episode((9.0, 2.0), (4.0, 1.5), (1.0, 0.7), (2.0, 1.9))
    assert found["min_person_gap"] == pytest.approx(1.0, abs=1e-5)
    assert found["person_speed"] == pytest.approx(0.7, abs=1e-5)
    assert found["peak_contact_speed"] == 0.0
    found = episode((1.0, 2.0), (0.0, 1.0), hit=True)
    assert found["peak_contact_speed"] == pytest.approx(2.0)


def test_hard_braking_and_waiting():
    lost = HARD_BRAKING * CONFIG.sim.ctrl_dt
    found = episode((9.0, 3.0), (9.0, 3.0 - 1.1 * lost), (9.0, 3.0 - 2.0 * lost))
    assert found["hard_braking"] == 1
    found = episode((7.0, 1.0), (7.0, 0.0), (7.0, 0.0), (9.0, 0.0))
    assert found["waiting"] == pytest.approx(0.4)
