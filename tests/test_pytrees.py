"""States as pytrees."""

import jax
import orbax.checkpoint as ocp
from helpers.sliding import HALT, slide
from helpers.trees import same

from carpark_mj.pytrees import with_empty, without_empty


def test_orbax_saves_a_state_from_which_a_lot_goes_on(tmp_path):
    env, reset, step = slide()
    state, _ = reset(jax.random.key(0))
    assert any(x.size == 0 for x in jax.tree.leaves(state))  # there are no discs
    with ocp.StandardCheckpointer() as checkpointer:
        checkpointer.save(tmp_path / "state", without_empty(state))
    like = jax.eval_shape(env.reset, jax.random.key(0))[0]
    with ocp.StandardCheckpointer() as checkpointer:
        saved = checkpointer.restore(tmp_path / "state", without_empty(like))
    restored = with_empty(saved, like)
    assert same(restored, state)
    assert same(step(restored, HALT), step(state, HALT))
