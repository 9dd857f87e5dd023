"""The PPO learner: builds the training state and the compiled update.

Networks, statistics and GAE are of Brax. Lots are sharded over the devices, parameters
replicated, gradients averaged.
"""

import copy
import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from carpark_mj.compilation import FUSION_AUTOTUNER
from carpark_mj.config import insert, is_data
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.keys import training_key
from carpark_mj.mdp.rewards import term_weights
from carpark_mj.observations import make_fields
from carpark_mj.physics.unrolled import has_triton
from carpark_mj.policy.checkpoints import is_key
from carpark_mj.policy.networks import (
    Arithmetic,
    init_normalizer,
    make_networks,
    make_policy,
    network_inputs,
)
from carpark_mj.training.ppo.collect import (
    AXIS,
    Rollout,
    Totals,
    TrainingState,
    collect,
    make_families,
    no_steps,
    state_specs,
)
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learn import (
    crash_scale,
    learn,
    network_params,
    training_env,
)
from carpark_mj.training.ppo.parts import VARIANTS
from carpark_mj.training.ppo.warm_start import make_teacher
from carpark_mj.wrappers.brax import BraxParking

ENV = "env."
Values = Mapping[str, Any]  # of settings, by path
# Terms of the reward that `crash_scale` of a curriculum is a factor on.
SCALED = ("crash", "person")
COMPILER_OPTIONS = {FUSION_AUTOTUNER: False}  # also where JAX has begun before


def num_devices(config: PPOConfig) -> int:
    """The most devices that lots and minibatches divide over evenly."""

    def fits(n: int) -> bool:
        agents = config.num_lots // n * config.env.num_agents
        return config.num_lots % n == 0 and agents % config.num_minibatches == 0

    count = jax.device_count()
    if jax.process_count() > 1 and not fits(count):
        raise ValueError(
            f"num_lots {config.num_lots}, and the agents of a device's lots over "
            f"num_minibatches {config.num_minibatches}, must divide evenly over the "
            f"{count} devices of {jax.process_count()} hosts"
        )
    return max(n for n in range(1, count + 1) if fits(n))


def due_lots(update: jax.Array | int, num_lots: int, life: int) -> jax.Array:
    """Lots (n,) int32 redrawn after an update, in turns: none outlives its life."""
    count = -(-num_lots // life)
    return (update * count + jnp.arange(count)) % num_lots


class Learner:
    """Builds the initial training state and the compiled update of a config.

    Attributes:
        configs: of every run that is trained; `config` is the first one's.
    """

    def __init__(self, config: PPOConfig) -> None:
        """Sets up environment, networks, optimiser and mesh."""
        self.config = config
        self.configs: tuple[PPOConfig, ...] = (config,)
        self.env = BraxParking(ParkingEnv(training_env(config)))
        self.renews_lots = config.lot_life > 0 and self.env.env.layout_config.is_random
        lots, target = self.env.env.layout_config, config.curriculum.target_rate
        self.families = make_families(target, lots, config.env.agent_counts)
        self.scaled = [name for name in SCALED if name in term_weights(config.env)]
        fields, action = make_fields(config.env), self.env.env.action_spec
        self.inputs = network_inputs(config.networks, fields)
        self.teacher = make_teacher(config)
        dtype = jnp.bfloat16 if config.half_precision else jnp.float32
        arithmetic = Arithmetic(has_triton(), dtype)
        self.networks = make_networks(config.networks, fields, action, arithmetic)
        self.optimizer = optax.chain(
            optax.clip_by_global_norm(config.max_grad_norm), optax.scale_by_adam()
        )
        devices = jax.devices()[: num_devices(config)]
        self.mesh = Mesh(devices, (AXIS,))
        self.specs = state_specs()

    def init(self) -> TrainingState:
        """The state before the first update, laid out over the devices."""
        return self.place(self._jitted_build())

    def build(self) -> TrainingState:
        """The state before the first update (pure)."""
        return self.begin(training_key(self.config.seed))

    @functools.cached_property
    def _jitted_build(self) -> Callable[[], TrainingState]:
        """Traced once for the shapes and the state."""
        return jax.jit(self.build, compiler_options=COMPILER_OPTIONS)

    def begin(self, key: jax.Array) -> TrainingState:
        """The state of a run with this key before the first update (pure)."""
        policy_key, value_key, env_key, key = jax.random.split(key, 4)
        params = network_params(
            self.networks.policy_network.init(policy_key),
            self.networks.value_network.init(value_key),
        )
        params, key = VARIANTS[self.config.variant].initial_weights(params, key)
        rates = self.families.init()
        lots = self.families.draw(rates, env_key, self.config.num_lots)
        state = TrainingState(
            normalizer=init_normalizer(self.inputs),
            policy=params.policy,
            average=params.policy,
            value=params.value,
            optimizer=self.optimizer.init(ravel_pytree(params)[0]),
            key=key,
            update=jnp.zeros((), jnp.int32),
            steps=no_steps(),
            skipped=jnp.zeros((), jnp.int32),
            seconds=jnp.zeros((), jnp.float32),
            family_rates=rates,
            env=self.env.reset(*lots),
        )
        return jax.tree.map(_without_weak_type, state)

    def shapes(self) -> TrainingState:
        """Shapes and dtypes of a training state."""
        return jax.eval_shape(self._jitted_build)

    def place(self, state: TrainingState) -> TrainingState:
        """Lays a state out over the devices: lots sharded, the rest replicated."""
        return jax.tree.map(
            lambda sharding, part: jax.tree.map(lambda x: _put(x, sharding), part),
            self._shardings(),
            state,
        )

    def gather(self, state: TrainingState) -> TrainingState:
        """The whole state in this host's memory; all hosts must call it."""
        if jax.process_count() > 1:
            whole = NamedSharding(self.mesh, PartitionSpec())
            # Keys as the integers that checkpoints hold.
            plain = functools.partial(
                jax.tree.map, lambda x: jax.random.key_data(x) if is_key(x) else x
            )
            state = jax.jit(plain, out_shardings=whole)(state)
        return jax.device_get(state)

    def split(self, state: TrainingState) -> list[TrainingState]:
        """The state of every run."""
        return [state]

    def join(self, states: Sequence[TrainingState]) -> TrainingState:
        """The state of all runs, from that of every one."""
        (state,) = states
        return state

    def set_seconds(self, state: TrainingState, seconds: float) -> TrainingState:
        """The state with what is used of the budget; nothing recompiles for it."""
        used = np.full(state.seconds.shape, seconds, np.float32)
        shardings: Any = self._shardings()
        return dataclasses.replace(state, seconds=_put(used, shardings.seconds))

    def _shardings(self) -> TrainingState:
        return jax.tree.map(
            lambda spec: NamedSharding(self.mesh, spec),
            self.specs,
            is_leaf=lambda x: isinstance(x, PartitionSpec),
        )

    def compile(self, scheduled: bool = False) -> Callable[..., Any]:
        """The jitted update `state -> (state, metrics)`; it consumes the state.

        A `scheduled` one takes values, too, see `with_values` and `as_arrays`.
        """

        def update(state: TrainingState, *values: Values) -> Any:
            run = self.with_values(*values) if values else self
            return run.update(jax.tree.map(without_input, state))

        whole = PartitionSpec()
        return self._jitted(update, (self.specs, *[whole] * scheduled), whole)

    def with_values(self, values: Values) -> Self:
        """The learner with other values of settings that are data, by path.

        `ValueError` of others; see `ParkingEnv.with_values`.
        """
        run = copy.copy(self)
        own = {k.removeprefix(ENV): x for k, x in values.items() if k.startswith(ENV)}
        for path in values:
            if not (path.startswith(ENV) or is_data(self.config, path)):
                raise ValueError(f"{path} is no number that may change in a training")
        run.config = insert(self.config, values)
        # `ParkingEnv.step` pays from its own config.
        run.env = BraxParking(self.env.env.with_values(own))
        return run

    def as_arrays(self, values: Sequence[Values]) -> Values:
        """Values of every run as `compile`'s update takes them."""
        (own,) = values
        return {path: np.asarray(x, np.float32) for path, x in own.items()}

    def _jitted(
        self, update: Callable[..., Any], inputs: Any, metrics: PartitionSpec
    ) -> Callable[..., Any]:
        """An update over the devices; `inputs` and `metrics` are divided so."""
        # Results are laid out explicitly; otherwise on one device JAX treats some lots
        # as replicated and recompiles for the second update.
        return jax.jit(
            jax.shard_map(
                update,
                mesh=self.mesh,
                in_specs=inputs,
                out_specs=(self.specs, metrics),
                check_vma=False,
            ),
            donate_argnums=0,
            out_shardings=(self._shardings(), NamedSharding(self.mesh, metrics)),
            compiler_options=COMPILER_OPTIONS,
        )

    def update(
        self, state: TrainingState
    ) -> tuple[TrainingState, dict[str, jax.Array]]:
        """Collects one unroll of every agent and learns from it (one device's share).

        An update with any non-finite number is discarded: parameters, optimiser and
        statistics are unchanged and `skipped` counts it.
        """
        key, act_key, learn_key = jax.random.split(state.key, 3)
        local = jax.lax.axis_index(AXIS)
        act_key = jax.random.fold_in(act_key, local)
        env_state, rollout, totals = self._collect(state, act_key)
        rates = state.family_rates
        if self.families.target:
            rates = self.families.update(rates, env_state.info, totals, AXIS)
        if self.renews_lots:
            key, renew_key = jax.random.split(key)
            renew_key = jax.random.fold_in(renew_key, local)
            env_state = self._renew(env_state, state.update, rates, renew_key)
        learned, losses = learn(
            self.config,
            self.networks,
            self.inputs,
            self.optimizer,
            state,
            rollout,
            jax.random.fold_in(learn_key, local),
        )
        numbers = jax.tree.leaves((learned, losses))
        finite = jnp.stack([jnp.all(jnp.isfinite(x)) for x in numbers]).all()
        old = (state.normalizer, state.policy, state.value, state.optimizer)
        kept = jax.tree.map(lambda new, old: jnp.where(finite, new, old), learned, old)
        normalizer, policy, value, optimizer = kept
        weight = 1.0 / jnp.minimum(state.update + 1.0, self.config.averaged_updates)
        average = jax.tree.map(
            lambda mean, last: mean + jnp.where(finite, weight, 0.0) * (last - mean),
            state.average,
            policy,
        )
        num_steps = jnp.int32(self.config.steps_per_update)
        if rollout.weight is not None:
            num_steps = jax.lax.psum(rollout.weight.sum(dtype=jnp.int32), AXIS)
        new = TrainingState(
            normalizer=normalizer,
            policy=policy,
            average=average,
            value=value,
            optimizer=optimizer,
            key=key,
            update=state.update + 1,
            steps=state.steps + num_steps,
            skipped=state.skipped + ~finite,
            seconds=state.seconds,
            family_rates=rates,
            env=env_state,
        )
        metrics = _episode_metrics(totals, num_steps)
        metrics |= {f"loss/{name}": loss for name, loss in losses.items()}
        metrics["progress"] = self.config.progress(state.update, state.seconds)
        metrics |= self.families.metrics(rates) | {"skipped": new.skipped}
        return jax.tree.map(_without_weak_type, (new, metrics))

    def _collect(
        self, state: TrainingState, key: jax.Array
    ) -> tuple[Any, Rollout, Totals]:
        """Drives all agents for one unroll."""
        actor: Any = make_policy(
            self.networks, state.normalizer, state.policy, deterministic=False
        )
        progress = self.config.progress(state.update, state.seconds)
        curriculum = self.config.curriculum
        return collect(
            self.env,
            state.env,
            actor,
            key,
            self.config.unroll_length,
            dict.fromkeys(self.scaled, crash_scale(curriculum, progress)),
            with_neighbours=curriculum.neighbour_share > 0.0,
            teacher=self.teacher,
        )

    def _renew(
        self, env_state: Any, update: jax.Array, rates: jax.Array, key: jax.Array
    ) -> Any:
        """Redraws the lots that are due (one device's share).

        It happens between unrolls, where the value is bootstrapped anyway, so that
        episodes cut off are truncated correctly; they do not count as ended.
        """
        num_lots = self.config.num_lots // self.mesh.shape[AXIS]
        lots = due_lots(update, num_lots, self.config.lot_life)
        drawn = self.families.draw(rates, key, len(lots))
        return self.env.renew(env_state, lots, *drawn)


def _episode_metrics(totals: Totals, num_steps: jax.Array) -> dict[str, jax.Array]:
    """Means over the episodes that ended in the unroll, and reward terms per step."""
    totals = jax.tree.map(lambda x: jax.lax.psum(x.sum(), AXIS), totals)
    episodes = totals.episodes
    metrics = {"episodes": episodes}
    for name, total in totals.episode_metrics.items():
        metrics[f"episode/{name}"] = total / jnp.maximum(episodes, 1.0)
    for name, total in totals.reward_terms.items():
        metrics[f"reward/{name}"] = total / num_steps
    return metrics


def _put(x: Any, sharding: NamedSharding) -> jax.Array:
    """Lays out an array that every host has whole."""
    if jax.process_count() == 1:
        return jax.device_put(x, sharding)
    if is_key(x):
        return jax.random.wrap_key_data(_put(jax.random.key_data(x), sharding))
    host = np.asarray(x)
    return jax.make_array_from_callback(host.shape, sharding, lambda i: host[i])


def without_input(x: jax.Array) -> jax.Array:
    """The array, as a constant if it is empty: JAX drops inputs that nothing uses.

    XLA 0.11 crashes partitioning a `shard_map` with an empty input (a lot without discs
    has some): on two devices, of `lambda x, empty: x + empty.sum(axis=1)`.
    """
    return x if x.size else jnp.zeros(x.shape, x.dtype)


def _without_weak_type(x: Any) -> jax.Array:
    """The array without weak type, so that the second update does not recompile."""
    x = jnp.asarray(x)
    return x if is_key(x) else x.astype(x.dtype)
