"""Driving by hand: keys and gamepads, a live lot that is recorded, its pictures."""

import contextlib
import dataclasses
from collections.abc import Callable, Generator, Iterator, Sequence, Set
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial

from carpark_mj.env import ParkingEnv
from carpark_mj.play.demonstration import STEPS, Demonstration
from carpark_mj.policy.acting import Step, as_argument
from carpark_mj.policy.networks import Policy
from carpark_mj.rendering.renderer import LotRenderer
from carpark_mj.rendering.video import draw_labelled, write_video
from carpark_mj.rendering.web import LiveLot
from carpark_mj.types import ENDINGS

LEFT, RIGHT = ("LEFT", "A"), ("RIGHT", "D")
AHEAD, BACK = ("UP", "W"), ("DOWN", "S")
BRAKE = ("SPACE",)
KEYS = (*LEFT, *RIGHT, *AHEAD, *BACK, *BRAKE)

# [est] By trial: as quick as a hand at a wheel, and gentle enough to park with.
STEER_RATE = 2.0  # 1/s, while a key is held, and back to the middle without
KEY_PEDAL = 0.6
AGAIN = "It has started again elsewhere; R restarts the lot."
DEADZONE = 0.1  # of a stick's travel
STANDING = 0.1  # m/s, below which the brake key leaves the car to its brake

# Axes of GLFW's gamepads: right is 1; triggers rest at -1.
STICK, LEFT_TRIGGER, RIGHT_TRIGGER = 0, 4, 5


@dataclasses.dataclass(frozen=True)
class Controls:
    """Controls of a driver."""

    steer: float = 0.0  # left is 1
    pedal: float = 0.0  # ahead is 1; against the motion it brakes

    @property
    def action(self) -> np.ndarray:
        """(2,) float32 steer and pedal."""
        return np.array([self.steer, self.pedal], np.float32).clip(-1.0, 1.0)


def from_keys(
    held: Set[str], before: Controls, speed: float, seconds: float
) -> Controls:
    """Steers step by step while `KEYS` are held, and back to the middle without.

    The controls `before` were some `seconds` ago; speed is forwards positive [m/s].
    """
    wanted = _any(held, LEFT) - _any(held, RIGHT)
    most = STEER_RATE * seconds
    steer = before.steer + float(np.clip(wanted - before.steer, -most, most))
    pedal = KEY_PEDAL * (_any(held, AHEAD) - _any(held, BACK))
    if _any(held, BRAKE):
        pedal = stop(speed)
    return Controls(steer, pedal)


def from_gamepad(axes: Sequence[float]) -> Controls:
    """Left stick steers, the right trigger drives ahead, the left one back."""
    stick = -axes[STICK]
    past = max(0.0, abs(stick) - DEADZONE) / (1.0 - DEADZONE)
    pedal = (axes[RIGHT_TRIGGER] - axes[LEFT_TRIGGER]) / 2
    return Controls(float(np.copysign(past, stick)), pedal)


def stop(speed: float) -> float:
    """The pedal that brakes a car of some speed [m/s] and holds it."""
    return 0.0 if abs(speed) < STANDING else -float(np.sign(speed))


def _any(held: Set[str], names: Sequence[str]) -> int:
    return int(any(name in held for name in names))


class DrivenLot(LiveLot):
    """A `LiveLot` whose first agents are driven from outside, the others by a policy.

    Attributes:
        speed: of agent 0 after the last control step [m/s].
        score: sum of its rewards.
        note: how the agent's last episode has ended, and how to go on.
    """

    def __init__(
        self,
        env: ParkingEnv,
        others: Policy,
        seed: int,
        read: Callable[["DrivenLot"], np.ndarray],
        keep: Callable[["DrivenLot"], None] = lambda lot: None,
    ) -> None:
        """Compiles and starts a lot of cars that steer.

        Args:
            env: of the lot.
            others: policy of the other agents.
            seed: seed of the lot.
            read: the actions (k, size) of the first k agents, asked for at the start of
                every control step.
            keep: called before the lot restarts, with what has been recorded.
        """
        physics = env.config.physics_config
        if not physics.steers:
            raise ValueError(
                f"physics must be of cars that steer, not {physics.back_end!r}"
            )
        self._others, self._read, self._seed = as_argument(others), read, seed
        self._recorded: list[dict[str, np.ndarray]] = []
        self._keep = keep
        self._after = AGAIN if env.config.episode.respawn else "R restarts the lot."
        self.speed = self.score = 0.0
        one = np.zeros((1, env.action_spec.size), np.float32)
        super().__init__(env, self._driven(one), seed)

    def reset(self) -> None:
        """Restarts the lot; what was recorded is kept by `keep` or forgotten."""
        self._keep(self)
        super().reset()
        self._recorded = []
        self.speed = self.score = 0.0
        self.note = ""

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
            for name in ENDINGS:
                if self._seen[f"own {name}"]:
                    ended = f"{name.replace('_', ' ')} at {self.seconds:.0f} s"
                    self.note = f"Your car {ended}. {self._after}"
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
        recorded = self._recorded
        arrays = {name: np.stack([step[name] for step in recorded]) for name in STEPS}
        return Demonstration(self._env.config, self._seed, **arrays)

    def _driven(self, action: np.ndarray) -> Partial:
        return Partial(_mix, jnp.asarray(action), self._others)

    def _record(self, step: Step) -> dict[str, jax.Array]:
        timestep, seen = step.timestep, step.timestep.observation
        if timestep.final_observation is not None:  # others have not respawned
            done = timestep.events.done[:, None]
            seen = jnp.where(done, timestep.final_observation, seen)
        own = {f"own {name}": getattr(timestep.events, name)[0] for name in ENDINGS}
        return own | {
            "observations": step.observation,
            "next_observations": seen,
            "actions": step.action,
            "rewards": timestep.reward,
            "terminated": timestep.terminated,
            "truncated": timestep.truncated,
            "success": timestep.events.success,
            "poses": step.before.motion.pose_w,
            "next_poses": timestep.motion.pose_w,
            "speed": timestep.motion.speed[0],
        }


def _mix(first: jax.Array, others: Policy, observation: jax.Array, key: jax.Array):
    """Actions given of the first agents, by the policy of the others."""
    action, extras = others(observation, key)
    return action.at[: first.shape[0]].set(first), extras


SIZE = (1280, 720)  # pixels


@contextlib.contextmanager
def pictures(lot: DrivenLot, camera: str) -> Generator[Callable[[], np.ndarray]]:
    """Gives what draws the present instant with labels, clock, tallies and score."""
    with contextlib.closing(LotRenderer(lot.stage, camera, SIZE)) as renderer:
        yield lambda: draw_labelled(lot.snapshot(), renderer)


def record_video(lot: DrivenLot, camera: str, steps: int, path: Path) -> int:
    """Writes `steps` control steps as a video; returns the number of frames."""
    with pictures(lot, camera) as draw:

        def frames() -> Iterator[np.ndarray]:
            for _ in range(steps * lot.traces):
                lot.step()
                yield draw()

        return write_video(path, frames(), 1.0 / lot.stage.model.opt.timestep)
