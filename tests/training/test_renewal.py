"""Training draws its random lots anew, a few after every update."""

import dataclasses
import itertools

import jax
import numpy as np
import pytest
from helpers.sliding import POSES, SlidePhysics
from helpers.trees import leaves, same

from carpark_mj.config import EnvConfig, EpisodeConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import StreetConfig
from carpark_mj.policy import checkpoints
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo.collect import TrainingState
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learner import Learner, due_lots
from carpark_mj.wrappers.brax import BraxParking

STREET = StreetConfig(bays_per_side=(3, 4))
LOTS, AGENTS, UNROLL = 6, 2, 5
CONFIG = PPOConfig(
    num_lots=LOTS,
    lot_life=3,
    unroll_length=UNROLL,
    num_minibatches=1,
    num_epochs=1,
    networks=NetworkConfig((8,), (8,)),
    env=EnvConfig(
        layout=STREET,
        physics="bicycle",
        observation=POSES,
        num_agents=AGENTS,
        num_parked_cars=1,
        episode=EpisodeConfig(max_steps=50),
    ),
)


class Watched(Learner):
    """A learner whose updates also return an unroll and the lots around it."""

    def _collect(self, state, key):
        env_state, rollout, totals = super()._collect(state, key)
        self.seen = {"unroll": (rollout, totals), "before": env_state}
        return env_state, rollout, totals

    def _renew(self, env_state, update, rates, key):
        renewed = super()._renew(env_state, update, rates, key)
        fresh = self.env.reset(jax.random.split(key))
        self.seen |= {"after": renewed, "fresh": fresh}
        return renewed

    def update(self, state):
        new, metrics = super().update(state)
        return new, metrics | self.seen


@pytest.fixture(scope="module")
def history(tmp_path_factory):
    """A compiled update, the states before and after four, and what the second saw.

    Also a function that loads the state after the first from its checkpoint.
    """
    learner = Watched(CONFIG)
    learner.env = BraxParking(ParkingEnv(CONFIG.env, SlidePhysics()))
    update, state = learner.compile(), learner.init()
    path, seen, found = tmp_path_factory.mktemp("run") / "1.npz", [host(state)], []
    for number in range(4):
        if number == 1:
            checkpoints.save(path, vars(state), {})
        state, metrics = update(state)
        seen.append(host(state))
        found.append(metrics)
    assert update._cache_size() == 1  # neither weak types nor layout recompiled it

    def load():
        tree = checkpoints.load(path, vars(learner.shapes()))
        return learner.place(TrainingState(**tree))

    return update, load, seen, host(found[1])


@pytest.fixture(scope="module")
def renewal(history):
    """An unroll, the lots after it, after renewal, and the two fresh ones in them."""
    return [history[-1][name] for name in ("unroll", "before", "after", "fresh")]


def host(state):
    """A copy as numpy arrays, keys by their data."""
    return jax.tree.unflatten(jax.tree.structure(state), map(np.array, leaves(state)))


def layouts(state):
    return state.env.pipeline_state.layout


@pytest.mark.parametrize(("num_lots", "life"), [(6, 3), (64, 16), (32, 5), (4, 10)])
def test_lots_take_turns_and_none_lasts_longer_than_its_life(num_lots, life):
    due = [np.asarray(due_lots(u, num_lots, life)) for u in range(4 * num_lots)]
    assert len({len(lots) for lots in due}) == 1  # as many at every update
    for lots in due:
        assert len(set(lots.tolist())) == len(lots)
    for lot in range(num_lots):
        times = [u for u, lots in enumerate(due) if lot in lots]
        assert times[0] < life
        assert np.diff(times).max() <= life
        if num_lots % life == 0:
            assert set(np.diff(times)) == {life}


def test_an_update_renews_lots_that_are_due_and_no_others(history):
    _, _, seen, _ = history
    for number, (before, after) in enumerate(itertools.pairwise(seen)):
        due = due_lots(number, LOTS, CONFIG.lot_life).tolist()
        changed = np.any(layouts(before).extent != layouts(after).extent, axis=-1)
        assert np.flatnonzero(changed).tolist() == due
        # Episodes in a new lot have just begun, with the observation of its start.
        step = after.env.pipeline_state.step
        assert (step[due] == 0).all()
        kept = [lot for lot in range(LOTS) if lot not in due]
        assert (step[kept] > 0).any()
    drawn = {lot.tobytes() for state in seen for lot in layouts(state).bay_pose}
    assert len(drawn) == LOTS + 4 * 2


def test_a_renewed_lot_is_a_fresh_one_and_the_others_stay(renewal):
    _, before, after, fresh = renewal
    agents = np.arange(4, 8)  # of lots 2 and 3, whose turn it is
    rest = np.setdiff1d(np.arange(LOTS * AGENTS), agents)
    np.testing.assert_array_equal(after.obs[agents], fresh.obs)
    np.testing.assert_array_equal(after.obs[rest], before.obs[rest])
    lots = [jax.tree.leaves(x.pipeline_state) for x in (before, after, fresh)]
    for old, new, start in zip(*lots, strict=True):
        np.testing.assert_array_equal(new[[2, 3]], start)
        np.testing.assert_array_equal(new[[0, 1, 4, 5]], old[[0, 1, 4, 5]])


def test_episodes_cut_off_are_bootstrapped_in_their_lot(renewal):
    """The last step of an unroll keeps what the agents saw before the renewal."""
    (rollout, totals), before, after, _ = renewal
    assert rollout.observation.shape[:2] == (UNROLL, LOTS * AGENTS)
    np.testing.assert_array_equal(rollout.final_observation, before.obs)
    cut = np.any(after.obs != rollout.final_observation, axis=-1)
    assert np.flatnonzero(cut).tolist() == [4, 5, 6, 7]
    # Neither the end of an episode nor a reward is made up for the cut.
    ended = (rollout.terminated + rollout.truncated).sum(axis=0)
    np.testing.assert_array_equal(ended, totals.episodes)


def test_a_resumed_training_draws_the_same_lots(history):
    update, load, seen, _ = history
    assert same(host(update(load())[0]), seen[2])


@pytest.mark.parametrize(
    ("layout", "life", "expected"),
    [("square_compact", 16, False), (STREET, 0, False), (STREET, 16, True)],
)
def test_lots_that_no_key_changes_or_with_no_end_of_life_stay(layout, life, expected):
    env = dataclasses.replace(CONFIG.env, layout=layout)
    config = dataclasses.replace(CONFIG, env=env, lot_life=life)
    assert Learner(config).renews_lots is expected
