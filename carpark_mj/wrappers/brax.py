"""A batch of lots as one Brax environment: `lots x agents` flattened to its batch.

Brax's acting, loss and statistics then treat every agent as an environment of its own
that shares the policy (IPPO).
"""

from typing import Any

import jax
import jax.numpy as jnp

# Before Brax, which imports MJX, too: this import is quiet about missing Warp.
import carpark_mj.physics.mjx_step  # isort: skip # noqa: F401  # pyright: ignore
from brax.envs.base import Env
from brax.envs.base import State as BraxState

from carpark_mj.env import ParkingEnv
from carpark_mj.physics.base import where_cars
from carpark_mj.types import State, TimeStep


class BraxParking(Env):
    """`num_lots` lots of `env.num_agents` agents each.

    `reset(keys)` takes (num_lots,) keys. Observations, rewards, `done` and everything
    in `info` but the state have the leading dimension num_lots * num_agents. Mask steps
    of absent agents, where `info["present"]` is 0; it is None if agents are never
    absent. `info["final_observation"]` is that of `TimeStep`, None unless
    `EpisodeConfig.final_observation`. Agents auto-reset.
    """

    def __init__(self, env: ParkingEnv) -> None:
        """Wraps one lot's environment."""
        self.env = env

    def reset(
        self,
        rng: jax.Array,
        member: jax.Array | None = None,
        num_present: jax.Array | None = None,
    ) -> BraxState:
        """Starts the lots, one per key (num_lots,), which are consumed.

        `member` (num_lots,) int32 is which member of a mixture each lot is of,
        `num_present` (num_lots,) int32 how many agents each is to have (some have room
        for fewer only). Both are kept in `info`, and drawn if None.
        """
        given: dict[str, Any] = {"member": member, "num_present": num_present}
        state, observation = jax.vmap(self.env.reset)(rng, **given)
        observation = _flatten(observation)
        zero = jnp.zeros(observation.shape[:1], jnp.float32)
        spec = self.env.action_spec
        action = jnp.zeros((self.env.num_agents, spec.size), spec.dtype)
        lot = jax.eval_shape(
            lambda s: self.env.step(s, action)[1], jax.tree.map(lambda x: x[0], state)
        )
        final = None if lot.final_observation is None else jnp.zeros_like(observation)
        info = {
            "truncation": zero,
            "present": _presence(state),
            "episode_done": zero,
            "episode_metrics": {name: zero for name in lot.metrics},
            "reward_terms": {name: zero for name in lot.reward_terms},
            "final_observation": final,
        }
        for name, value in given.items():
            if value is not None:
                info[name] = jnp.repeat(value, self.env.num_agents)
        return BraxState(
            pipeline_state=state,  # pyright: ignore[reportArgumentType]
            obs=observation,
            reward=zero,
            done=zero,
            metrics={},
            info=info,
        )

    def renew(
        self,
        state: BraxState,
        lots: jax.Array,
        keys: jax.Array,
        member: jax.Array | None = None,
        num_present: jax.Array | None = None,
    ) -> BraxState:
        """Redraws the lots (n,) int32 and cuts off the episodes running in them.

        Args are those of `reset`; the keys (n,) are consumed.
        """
        fresh = self.reset(keys, member, num_present)
        num_lots = state.done.shape[0] // self.env.num_agents
        is_drawn = jnp.arange(num_lots)[:, None] == lots
        source, due = jnp.argmax(is_drawn, axis=1), jnp.any(is_drawn, axis=1)

        # Gathered, not scattered: XLA aborts where it fuses scatters on a CPU (0.10).
        def put(old: jax.Array, new: jax.Array) -> jax.Array:
            rows = old.shape[0] // num_lots  # 1, or the agents of a lot
            index = source[:, None] * rows + jnp.arange(rows)
            return where_cars(jnp.repeat(due, rows), new[index.reshape(-1)], old)

        return jax.tree.map(put, state, fresh)

    def step(self, state: BraxState, action: jax.Array) -> BraxState:
        """Steps all lots; `action` (num_lots * num_agents, size)."""
        lots: Any = state.pipeline_state
        action = action.reshape(-1, self.env.num_agents, self.action_size)
        lots, timestep = jax.vmap(self.env.step)(lots, action)
        timestep: TimeStep = jax.tree.map(_flatten, timestep)
        done = (timestep.terminated | timestep.truncated).astype(jnp.float32)
        info = state.info | {
            "truncation": timestep.truncated.astype(jnp.float32),
            "present": _presence(lots),
            "episode_done": done,
            "episode_metrics": timestep.metrics,
            "reward_terms": timestep.reward_terms,
            "final_observation": timestep.final_observation,
        }
        return state.replace(  # pyright: ignore[reportAttributeAccessIssue]
            pipeline_state=lots,
            obs=timestep.observation,
            reward=timestep.reward,
            done=done,
            info=info,
        )

    @property
    def observation_size(self) -> int:
        """Length of an agent's observation."""
        return self.env.observation_size

    @property
    def action_size(self) -> int:
        """Length of an agent's action."""
        return self.env.action_spec.size

    @property
    def backend(self) -> str:
        """Physics back end."""
        return type(self.env.physics).__name__


def _presence(lots: State) -> jax.Array | None:
    """1.0 for the agents that their lots have, see `State.present`; else 0.0."""
    present = lots.present
    return None if present is None else _flatten(present).astype(jnp.float32)


def _flatten(x: jax.Array) -> jax.Array:
    return x.reshape(-1, *x.shape[2:])
