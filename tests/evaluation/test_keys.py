"""Keys: no seed's training draws what some evaluation draws."""

import jax
import numpy as np

from carpark_mj.evaluation.keys import evaluation_key, training_key


def test_no_training_shares_its_key_with_an_evaluation():
    training, held_out = (
        {tuple(np.asarray(jax.random.key_data(key(seed)))) for seed in range(50)}
        for key in (training_key, evaluation_key)
    )
    assert len(training) == len(held_out) == 50
    assert not training & held_out
