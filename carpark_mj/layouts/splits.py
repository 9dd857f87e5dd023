"""Which random lots are for training and which are held out for evaluation.

Random lots are numbered from 0 to 2^32 - 1, and lot n is drawn from
`fold_in(key(0), n)`. Training draws from the lower half of the numbers, evaluation from
the upper half. Threefry, JAX's generator, is a block cipher: for a given key no two
numbers fold to the same key, so that no lot of one half is drawn in the other.
"""

from typing import Literal

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import require_choice

Split = Literal["train", "test"]
TRAIN = range(2**31)
TEST = range(2**31, 2**32)


def lot_number(split: Split, key: jax.Array) -> jax.Array:
    """Draws the number of a lot, uint32 (), uniform over a split.

    Raises:
        ValueError: unknown split.
    """
    require_choice("split", split, Split)
    first = TRAIN.start if split == "train" else TEST.start
    return jnp.uint32(first) + (jax.random.bits(key, (), jnp.uint32) >> 1)


def lot_key(number: jax.Array | int) -> jax.Array:
    """The key that lot `number` is drawn from."""
    return jax.random.fold_in(jax.random.key(0, impl="threefry2x32"), number)
