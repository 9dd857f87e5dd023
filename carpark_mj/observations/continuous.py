"""The continuous encoding: real numbers of order 1 in the observer's body frame."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import jax

from carpark_mj.config.checks import Natural
from carpark_mj.observations import ego, ranges, tracked
from carpark_mj.observations.fields import (
    ENCODERS,
    Field,
    ObservationConfig,
    ObservationInput,
    Part,
    Tracked,
)
from carpark_mj.observations.ranges import RayConfig, RingConfig, UltrasoundConfig
from carpark_mj.observations.sensors import observed, predicted
from carpark_mj.observations.tracked import (
    ShareConfig,
    mark,
    track_agents,
    track_parked_cars,
)
from carpark_mj.types import Motion, State

if TYPE_CHECKING:
    from carpark_mj.config import EnvConfig


@dataclasses.dataclass(frozen=True)
class ContinuousObservation(ObservationConfig):
    """Real numbers of order 1; `parts` lists them.

    Attributes:
        tracked_agents: number of nearest other agents observed, at most all in the lot.
        tracked_parked_cars: number of nearest parked cars observed, at most all.
        share: further properties of tracked agents that are observed.
        global_information: observe, for the goal or each tracked bay, the distances to
            the nearest agent and to the nearest agent with this goal.
        own_car: observe the own size, axles and turning radius; required if agents are
            drawn from a fleet.
        own_response: observe the own steering rate and lag, drive lag and acceleration,
            brake, mass, driven axle and speed limits.
        own_gear: observe the direction of the own last motion. A car at rest between
            two moves then knows which it has begun.
        own_past: observe the time, how often and where the car has changed its
            direction, and for how long it rests. A policy can then vary what failed.
        lines: observe the room between the own outline and the goal bay's lines.
        rings: circles that count objects.
        rays: bearings along which the free distance is observed.
        ultrasound: sensors in the bumpers and sides.
        route: observe the route along the lanes to the goal; fixed goals only.
        tracked_movers: number of nearest movers observed, people included.
        delay_compensation: observe where cars are now by their late poses and by speeds
            and yaw rates since, which cars know at once.
        encoding: name of the encoder; as a flag it chooses another.
    """

    tracked_agents: Natural = 6
    tracked_parked_cars: Natural = 4
    share: ShareConfig = dataclasses.field(default_factory=ShareConfig)
    global_information: bool = False
    own_car: bool = False
    own_response: bool = False
    own_gear: bool = False
    own_past: bool = False
    lines: bool = False
    rings: RingConfig = dataclasses.field(
        default_factory=lambda: RingConfig((5.0, 6.2, 8.0))
    )
    rays: RayConfig = dataclasses.field(default_factory=lambda: RayConfig(24))
    ultrasound: UltrasoundConfig = dataclasses.field(default_factory=UltrasoundConfig)
    route: bool = False
    tracked_movers: Natural = 0
    delay_compensation: bool = False
    encoding: str = "continuous"

    def parts(self, env: EnvConfig) -> list[Part]:
        """All parts in order. An extension adds to them.

        Other agents and parked cars have at least one slot each, so that the weights of
        a set encoder do not depend on their number.
        """
        num_bays = env.goals.num_tracked_bays if env.goals.dynamic else 0
        agents = min(self.tracked_agents, max(env.num_agents - 1, 1))
        parked_cars = min(self.tracked_parked_cars, max(env.num_parked_cars, 1))
        parts = [ego.MOTION, ego.GOAL]
        if num_bays:
            parts.append(ego.choice_part(num_bays))
            parts.append(ego.bays_part(num_bays, self.global_information))
        optional = (
            (self.global_information and not num_bays, ego.RIVALS),
            (self.lines, ego.LINES),
            (self.route, ego.ROUTE),
            (self.own_car, ego.CAR),
            (self.own_response, ego.RESPONSE),
            (self.own_gear, ego.GEAR),
            (self.own_past, ego.past_part(env.sim.ctrl_dt)),
        )
        parts += [part for on, part in optional if on]
        if agents:
            parts.append(tracked.agents_part(agents, self.share, num_bays))
        if parked_cars:
            parts.append(tracked.parked_cars_part(parked_cars))
        if self.tracked_movers:
            parts.append(tracked.movers_part(self.tracked_movers))
        if self.rings.diameters:
            parts.append(ranges.rings_part(self.rings))
        if self.rays.count:
            parts.append(ranges.rays_part(self.rays))
        if self.ultrasound.on:
            parts.append(ranges.ultrasound_part(self.ultrasound))
        return parts

    def fields(self, env: EnvConfig) -> list[Field]:
        """See `ObservationConfig.fields`."""
        return [field for part in self.parts(env) for field in part.fields]

    def values(self, env: EnvConfig, state: State) -> dict[str, jax.Array]:
        """See `ObservationConfig.values`."""
        return self.see(env, ObservationInput(state, self.known(env, state)))

    def known(self, env: EnvConfig, state: State) -> Motion:
        """See `ObservationConfig.known`."""
        late = observed(state)
        return predicted(state, env.sim.ctrl_dt) if self.delay_compensation else late

    def see(self, env: EnvConfig, sight: ObservationInput) -> dict[str, jax.Array]:
        """Values (num_observers, field.size) of all fields by name."""
        values = {}
        for part in self.parts(env):
            values |= part.fill(sight)
        return values

    @property
    def tracked(self) -> Tracked:
        """How many cars are tracked at most."""
        return Tracked(self.tracked_agents, self.tracked_parked_cars)

    @property
    def circles(self) -> tuple[float, ...]:
        """Diameters of the rings."""
        return self.rings.diameters

    def tracks_agents(self, state: State) -> jax.Array | None:
        """The nearest."""
        if not self.tracked_agents:
            return None
        pose = observed(state).pose_w
        tracked = track_agents(self.tracked_agents, pose, state.present)
        return mark(*tracked, pose.shape[0])

    def tracks_parked_cars(self, state: State) -> jax.Array | None:
        """The nearest."""
        if not self.tracked_parked_cars:
            return None
        pose, cars = observed(state).pose_w, state.parked_cars
        tracked = track_parked_cars(self.tracked_parked_cars, pose, cars)
        return mark(*tracked, cars.bay.shape[0])

    def init_memory(self, env: EnvConfig) -> dict[str, Any]:
        """What the rings counted and the car did before: nothing."""
        past = {"past": ego.init_past(env.num_agents)} if self.own_past else {}
        return ranges.init_history(self.rings, env.num_agents) | past

    def remember(self, state: State) -> dict[str, Any]:
        """What the rings have counted and the car has done."""
        past = {"past": ego.update_past(state)} if self.own_past else {}
        return ranges.update_history(self.rings, state) | past


ENCODERS.register("continuous", ContinuousObservation)
