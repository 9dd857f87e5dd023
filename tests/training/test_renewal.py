"""Training draws its random lots anew, those of families that fall short more often."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.learning import SMALL, sliding_learner
from helpers.sliding import SlidePhysics
from helpers.trees import leaves, same

from carpark_mj.config import insert
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import StreetConfig, layout_config
from carpark_mj.layouts.registry import mixture
from carpark_mj.policy import checkpoints
from carpark_mj.training.ppo.collect import (
    MEMORY,
    Families,
    Totals,
    TrainingState,
    make_families,
)
from carpark_mj.training.ppo.learner import Learner, due_lots
from carpark_mj.wrappers.brax import BraxParking

STREET = StreetConfig(bays_per_side=(3, 4))
LOTS, AGENTS, UNROLL = 6, 2, 5
CHANGES = {"num_lots": LOTS, "lot_life": 3, "unroll_length": UNROLL}
CHANGES |= {"env.layout": STREET, "env.num_agents": AGENTS, "env.episode.max_steps": 50}
CONFIG = insert(SMALL, CHANGES)


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
    learner = sliding_learner(CONFIG, Watched)
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


def test_a_renewed_lot_is_a_fresh_one_and_episodes_are_cut_off(history):
    """The last step of an unroll keeps what the agents saw before the renewal."""
    names = ("unroll", "before", "after", "fresh")
    (rollout, totals), before, after, fresh = (history[-1][name] for name in names)
    agents = np.arange(4, 8)  # of lots 2 and 3, whose turn it is
    rest = np.setdiff1d(np.arange(LOTS * AGENTS), agents)
    np.testing.assert_array_equal(after.obs[agents], fresh.obs)
    np.testing.assert_array_equal(after.obs[rest], before.obs[rest])
    lots = [jax.tree.leaves(x.pipeline_state) for x in (before, after, fresh)]
    for old, new, start in zip(*lots, strict=True):
        np.testing.assert_array_equal(new[[2, 3]], start)
        np.testing.assert_array_equal(new[[0, 1, 4, 5]], old[[0, 1, 4, 5]])
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


THREE = Families(0.9, {"lot": 0.5, "street": 0.25, "angled": 0.25}, range(2, 3))
# Pairs, in this order: lot 1, lot 2, street 1, street 2.
PAIRS = Families(0.9, {"lot": 0.75, "street": 0.25}, range(1, 3))
STREETS = mixture(
    [StreetConfig(bays_per_side=(3, 3)), StreetConfig(bays_per_side=(5, 5))]
)
# Every episode ends within an unroll.
CHANGES = {"env.layout": STREETS, "env.episode.max_steps": 2}
FAMILIES = insert(CONFIG, CHANGES | {"curriculum.target_rate": 0.9})


def updated(rates, member, episodes, parked, length):
    """Rates after an unroll of agents (devices, n) in three members."""

    def update(member, episodes, parked, length):
        totals = Totals(episodes, {"parked": parked, "length": length}, {})
        return THREE.update(jnp.array(rates), {"member": member}, totals, "devices")

    numbers = (jnp.asarray(x, jnp.float32) for x in (episodes, parked, length))
    after = jax.vmap(update, axis_name="devices")(jnp.asarray(member), *numbers)
    np.testing.assert_array_equal(after, np.broadcast_to(after[0], after.shape))
    return after[0]


def test_rates_are_running_means_by_steps_of_each_member():
    after = updated(
        (0.5, 0.5, 0.2),
        member=[[0, 1], [0, 1]],
        episodes=[[3.0, 2.0], [1.0, 0.0]],
        parked=[[2.0, 0.0], [1.0, 0.0]],
        length=[[90.0, 70.0], [30.0, 0.0]],
    )
    old = (1 - 1 / MEMORY) ** np.array([4.0, 2.0])
    # Of 120 steps, 60 and 30 were of episodes that parked.
    expected = [*(old * 0.5 + (1 - old) * (0.75, 0.0)), 0.2]
    np.testing.assert_allclose(after, expected, rtol=1e-5)
    # So many episodes leave nothing of what was before.
    many = 20 * MEMORY
    far = updated((0.5, 0.5, 0.2), [[2]], [[many]], [[many / 4]], [[many]])
    np.testing.assert_allclose(far, [0.5, 0.5, 0.25], atol=1e-6)
    # A lot of long episodes that time out is half of the lots, not a tenth.
    lots = [[0, 0]], [[9 * many, many]], [[9 * many, 0.0]], [[90 * many, 90 * many]]
    assert float(updated((0.9, 0.5, 0.2), *lots)[0]) == pytest.approx(0.5)


def test_pairs_are_drawn_half_by_their_shortfall():
    rates = jnp.array([0.9, 0.8, 0.95, 0.6])
    # By share 3/8, 3/8, 1/8, 1/8; shortfalls 0, 0.1, 0 and 0.3.
    expected = np.array([3 / 16, 3 / 16 + 1 / 8, 1 / 16, 1 / 16 + 3 / 8])
    np.testing.assert_allclose(PAIRS.probabilities(rates), expected, rtol=1e-5)
    _, member, present = PAIRS.draw(rates, jax.random.key(0), 4000)
    pair = 2 * np.asarray(member) + np.asarray(present) - 1
    share = np.bincount(pair, minlength=4) / 4000
    np.testing.assert_allclose(share, expected, atol=0.04)  # five deviations
    # Nothing known, all alike: half by share, half uniform.
    equal = PAIRS.probabilities(jnp.zeros(4))
    np.testing.assert_allclose(equal, np.array([5, 5, 3, 3]) / 16, rtol=1e-5)
    good = PAIRS.probabilities(jnp.full(4, 0.95))  # none falls short
    np.testing.assert_allclose(good, np.array([6, 6, 2, 2]) / 16, rtol=1e-5)
    # One family is drawn by its numbers of agents: shortfalls of 0.1 and 0.3.
    alone = make_families(0.9, layout_config("street"), range(1, 3))
    found = alone.probabilities(jnp.array([0.8, 0.6]))
    np.testing.assert_allclose(found, [0.25 + 0.125, 0.25 + 0.375], rtol=1e-5)


def test_rates_of_pairs_are_reported_as_means():
    many = 20 * MEMORY  # episodes that leave nothing of what was before
    parked = jnp.array([0.1, 0.2, 0.3, 0.4]) * many
    totals = Totals(jnp.full(4, many), {"parked": parked, "length": parked * 50}, {})
    info = {"member": jnp.array([1, 0, 0, 1]), "num_present": jnp.array([2, 2, 1, 1])}
    update = jax.vmap(PAIRS.update, (0, None, None, None), axis_name="devices")
    (rates,) = update(PAIRS.init()[None], info, totals, "devices")
    np.testing.assert_allclose(rates, [0.3, 0.2, 0.4, 0.1], atol=1e-6)
    found = PAIRS.metrics(rates)
    expected = {"family/lot": 0.25, "family/street": 0.25}
    expected |= {"agents/1": 0.35, "agents/2": 0.15}
    assert found == pytest.approx(expected)


def test_new_lots_have_the_numbers_of_agents_drawn():
    config = dataclasses.replace(FAMILIES.env, num_agents=3, min_agents=1)
    env = BraxParking(ParkingEnv(config, SlidePhysics()))
    keys, member = jax.random.split(jax.random.key(0), 4), jnp.array([0, 1, 1, 0])

    def run():
        state = env.reset(keys, member, jnp.array([3, 1, 2, 1]))
        lots, numbers = jnp.array([2, 0]), jnp.array([3, 2])
        return state, env.renew(state, lots, keys[:2], member[:2], numbers)

    begun, renewed = jax.jit(run)()
    for state, expected in ((begun, [3, 1, 2, 1]), (renewed, [2, 1, 3, 1])):
        present = np.asarray(state.pipeline_state.takes_part)
        np.testing.assert_array_equal(present.sum(axis=1), expected)
        np.testing.assert_array_equal(state.info["num_present"], np.repeat(expected, 3))


@pytest.mark.slow
def test_the_member_kept_for_every_agent_is_that_of_its_lot():
    learner = sliding_learner(FAMILIES)
    update, state = learner.compile(), learner.init()
    for _ in range(4):
        member = np.asarray(state.env.info["member"]).reshape(6, 2)
        np.testing.assert_array_equal(member[:, 0], member[:, 1])
        bays = state.env.pipeline_state.layout.bay_mask.sum(axis=1)
        np.testing.assert_array_equal(bays, np.where(member[:, 0], 10, 6))
        state, metrics = update(state)
    assert set(metrics) >= {"family/street", "family/street 2"}
    rates = [float(metrics[f"family/{name}"]) for name in ("street", "street 2")]
    np.testing.assert_array_equal(rates, state.family_rates)
