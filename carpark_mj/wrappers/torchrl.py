"""A batch of lots as one TorchRL environment, agents grouped as `agents`."""

# Its types do not fit its own use, and it may be absent.
# pyright: basic, reportMissingImports=false, reportArgumentType=false

from typing import Any, Unpack

import torch
from gymnasium import spaces
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from carpark_mj.mdp.goals import possible_choices
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.tasks.environment import AgentsEnvironment, JointEnv
from carpark_mj.wrappers.batch import Screen
from carpark_mj.wrappers.options import (
    OPTIONS,
    Options,
    configure,
    discrete_table,
    observation_space,
    require_numbers,
    share,
)
from carpark_mj.wrappers.torch_batch import TorchBatch

GROUP = "agents"
_ENDS = ("done", "terminated", "truncated")


class TorchRLAgents(EnvBase):
    """Many lots, or junctions, whose agents have one episode each; batch size (lots,).

    Keys are those of TorchRL's own multi-agent environments: under `agents`, of shape
    (lots, agents), `observation`, `action`, `reward`, `done`, `terminated`, `truncated`
    and, in `info`, whether the agent succeeded or `crashed` in the step; at the root
    `done`, `terminated` and `truncated` (lots, 1) of the lots, which are done when all
    of their agents are. Where agents choose bays, `action_mask` (lots, agents, actions)
    says which actions choose one that they track. An observation with pictures is a
    dictionary.

    An agent whose episode has ended stays terminated, observes zeros and earns 0 until
    its lot is reset; with `rewards.joint` of junctions it still earns the sum over all
    agents. All tensors are on JAX's device and share memory with its arrays. NaN and
    actions out of range are sanitized, not refused.
    """

    success = "parked"  # name of success in `info`

    def __init__(
        self,
        env: AgentsEnvironment,
        space: spaces.Box | spaces.Dict,
        screen: Screen,
        lots: int,
        options: Options,
        device: torch.device | str | None,
    ) -> None:
        """Wraps an environment in which agents that have finished wait for the others.

        It is compiled by the first reset and step. The device must be JAX's (None =
        that). Of the options it reads `discrete`; without it actions are numbers in
        [-1, 1].
        """
        table = discrete_table(env.action_spec, options)
        require_numbers(env.action_spec, table)
        self._lots = TorchBatch(env, lots, restart=False)
        on = self._lots.device
        if device is not None and torch.empty(0, device=device).device != on:
            raise ValueError(
                f"device must be {on}, on which JAX computes, not {device}"
            )
        super().__init__(device=on, batch_size=torch.Size([lots]))
        self.group_map = {GROUP: env.agents}
        self._env, self._seed, self._screen = env, None, screen
        self._table = None if table is None else torch.from_numpy(table).to(on)
        parks = isinstance(env, JointEnv)
        self._make_specs(space, chooses=parks and env.config.goals.dynamic)

    def _make_specs(self, space: spaces.Box | spaces.Dict, chooses: bool) -> None:
        """Specs of one lot; those of the batch follow from them."""
        agents = (self._env.num_agents,)
        action = Bounded(-1.0, 1.0, (*agents, self._env.action_spec.size))
        if self._table is not None:
            action = Categorical(len(self._table), agents)

        def flags(names: tuple[str, ...], *shape: int) -> dict[str, Categorical]:
            return {k: Categorical(2, (*shape, 1), dtype=torch.bool) for k in names}

        def grouped(specs: dict[str, Any]) -> Composite:
            return Composite({GROUP: Composite(specs, shape=agents)}).to(self.device)

        seen = {"observation": _spec(space, agents)}
        if chooses and self._table is not None:
            masks = (*agents, len(self._table))
            seen["action_mask"] = Categorical(2, masks, dtype=torch.bool)
        info = Composite(flags((self.success, "crashed"), *agents), shape=agents)
        self.full_action_spec_unbatched = grouped({"action": action})
        self.full_observation_spec_unbatched = grouped({**seen, "info": info})
        self.full_reward_spec_unbatched = grouped({"reward": Unbounded((*agents, 1))})
        done = grouped(flags(_ENDS, *agents))
        done.update(Composite(flags(_ENDS)).to(self.device))
        self.full_done_spec_unbatched = done

    def _reset(
        self,
        tensordict: TensorDictBase | None = None,
        options: ResetOptions | None = None,
    ) -> TensorDict:
        """Begins the lots that `_reset` (lots, 1) marks; without it, all."""
        due = None if tensordict is None else tensordict.get("_reset", None)
        if due is None:
            observation, self._seed = self._lots.reset(self._seed, options), None
        elif options is not None:
            raise ValueError("options need a reset of all lots, without `_reset`")
        else:
            observation = self._lots.restart(due.reshape(-1))
        active = torch.from_dlpack(self._lots.batch.state.active)
        no = torch.zeros_like(active)
        group = {"info": self._info(no, no), **self._seen(observation)}
        return self._pack(group, terminated=~active, truncated=no)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = tensordict.get((GROUP, "action"))
        if self._table is not None:
            action = self._table[action]
        step = self._lots.step(action)
        group = {
            **self._seen(step.observation),
            "reward": step.reward[..., None],
            "info": self._info(step.success, step.crashed),
        }
        return self._pack(group, step.terminated, step.truncated)

    def _seen(self, observation: Any) -> dict[str, Any]:
        """What agents observe, with the mask of their actions if they choose bays."""
        seen = {"observation": observation}
        choices = possible_choices(self._lots.batch.state)
        if choices is not None and self._table is not None:
            masks = torch.from_dlpack(choices)[..., self._table[:, -1].long()]
            seen["action_mask"] = masks
        return seen

    def _pack(
        self, group: dict[str, Any], terminated: torch.Tensor, truncated: torch.Tensor
    ) -> TensorDict:
        """Adds the ends of agents' episodes (lots, agents) and of the lots'."""
        done = terminated | truncated
        over = done.all(dim=1)
        cut = over & truncated.any(dim=1)
        ends = self._group(done=done, terminated=terminated, truncated=truncated)
        return TensorDict(
            {
                GROUP: TensorDict({**group, **ends}, ends.batch_size),
                "done": over[:, None],
                "terminated": (over & ~cut)[:, None],
                "truncated": cut[:, None],
            },
            self.batch_size,
            device=self.device,
        )

    def _info(self, success: torch.Tensor, crashed: torch.Tensor) -> TensorDict:
        return self._group(**{self.success: success, "crashed": crashed})

    def _group(self, **values: torch.Tensor) -> TensorDict:
        """Values (lots, agents) as entries (lots, agents, 1)."""
        shape = (*self.batch_size, self._env.num_agents)
        return TensorDict({k: v[..., None] for k, v in values.items()}, shape)

    def _set_seed(self, seed: int | None) -> None:
        """Takes effect at the next reset of all lots."""
        self._seed = seed

    def render(self, lot: int = 0) -> Any:
        """A picture (height, width, 3) uint8 of a lot, as an array of NumPy."""
        return self._screen.picture(self._lots.batch.state, lot)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Closes the renderer."""
        self._screen.close()
        super().close(raise_if_closed=raise_if_closed)


def _spec(space: Any, agents: tuple[int]) -> Any:
    """That of the observations (agents, ...) of a space, a dictionary's nested."""
    if isinstance(space, spaces.Dict):
        parts = {name: _spec(part, agents) for name, part in space.items()}
        return Composite(parts, shape=agents)
    shape = (*agents, *space.shape)
    low, high = (torch.tensor(x).expand(shape) for x in (space.low, space.high))
    # Samples of `Bounded` are not finite where a bound is infinite.
    if not (low.isfinite() & high.isfinite()).all():
        return Unbounded(low.shape, dtype=low.dtype)
    return Bounded(low, high, dtype=low.dtype)


class TorchRLParking(TorchRLAgents):
    """Lots in which agents park; see `TorchRLAgents`."""

    def __init__(
        self,
        lots: int = 1,
        *,
        device: torch.device | str | None = None,
        seed: int | None = None,
        **options: Unpack[Options],
    ) -> None:
        """Builds the environment of `Options`; see `TorchRLAgents` for the others.

        Lot i uses `seed` + i; None = unpredictable. There are no `details`.
        """
        config = configure(
            options, tuple(name for name in OPTIONS if name != "details")
        )
        env, space = share(JointEnv, config), observation_space(config)
        screen = Screen(env)
        super().__init__(env, space, screen, lots, options, device)
        self._seed = seed
