"""A lot in which somebody drives, live, and everything is recorded."""

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial

from carpark_mj.env import ParkingEnv
from carpark_mj.play.demonstration import STEPS, Demonstration
from carpark_mj.policy.acting import Step, as_argument
from carpark_mj.policy.networks import Policy
from carpark_mj.rendering.web import LiveLot


class DrivenLot(LiveLot):
    """A `LiveLot` whose first agents are driven from outside, the others by a policy.

    Attributes:
        speed: of agent 0 after the last control step [m/s].
        score: sum of its rewards.
    """

    def __init__(
        self,
        env: ParkingEnv,
        others: Policy,
        seed: int,
        read: Callable[["DrivenLot"], np.ndarray],
        keep: Callable[["DrivenLot"], None] = lambda lot: None,
    ) -> None:
        """Compiles and starts a lot.

        Args:
            env: of cars that steer.
            others: policy of the other agents.
            seed: of the lot.
            read: the actions (k, size) of the first k agents, asked for at the start of
                every control step.
            keep: called before the lot restarts, with what has been recorded.

        Raises:
            ValueError: a back end whose cars do not steer.
        """
        physics = env.config.physics_config
        if not physics.steers:
            raise ValueError(
                f"physics must be of cars that steer, not {physics.back_end!r}"
            )
        self._others, self._read, self._seed = as_argument(others), read, seed
        self._recorded: list[dict[str, np.ndarray]] = []
        self._keep = keep
        self.speed = self.score = 0.0
        one = np.zeros((1, env.action_spec.size), np.float32)
        super().__init__(env, self._driven(one), seed)

    def reset(self) -> None:
        """Restarts the lot; what was recorded is kept by `keep` or forgotten."""
        self._keep(self)
        super().reset()
        self._recorded = []
        self.speed = self.score = 0.0

    def step(self) -> bool:
        """Advances by one traced pose; see `LiveLot.step`."""
        if self.begins:
            self._policy = self._driven(np.asarray(self._read(self), np.float32))
        begins = super().step()
        if begins:
            assert self._seen is not None
            self._recorded.append({name: self._seen[name] for name in STEPS})
            self.speed = float(self._seen["speed"])
            self.score += float(self._seen["rewards"][0])
        return begins

    def tally(self) -> Iterator[tuple[str, float]]:
        """Episodes ended so far, by outcome, and agent 0's score."""
        yield from super().tally()
        yield "score", round(self.score, 1)

    @property
    def demonstration(self) -> Demonstration | None:
        """What has been driven since the start; None before the first step."""
        if not self._recorded:
            return None
        arrays = {
            name: np.stack([step[name] for step in self._recorded]) for name in STEPS
        }
        return Demonstration(self._env.config, self._seed, **arrays)

    def _driven(self, action: np.ndarray) -> Partial:
        return Partial(_mix, jnp.asarray(action), self._others)

    def _record(self, step: Step) -> dict[str, jax.Array]:
        timestep = step.timestep
        return {
            "observations": step.observation,
            "actions": step.action,
            "rewards": timestep.reward,
            "terminated": timestep.terminated,
            "truncated": timestep.truncated,
            "poses": timestep.motion.pose_w,
            "speed": timestep.motion.speed[0],
        }


def _mix(first: jax.Array, others: Policy, observation: jax.Array, key: jax.Array):
    """Actions given of the first agents, by the policy of the others."""
    action, extras = others(observation, key)
    return action.at[: first.shape[0]].set(first), extras
