"""Environments by name; the suite and other packages register more."""

import dataclasses

from carpark_mj.cameras.encoder import CameraObservation
from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    FleetConfig,
    GoalConfig,
    JitterConfig,
    RandomizationConfig,
    RayConfig,
    RewardConfig,
    RingConfig,
    SensorConfig,
    ShareConfig,
    SimConfig,
    SpawnConfig,
)
from carpark_mj.extensions import Registry
from carpark_mj.observations import ContinuousObservation

ENVIRONMENTS: Registry[EnvConfig] = Registry("environment")

# For a first try of one's own learner: all starts are on a way of at most 10 m out of
# the goal, among walls only, any heading is parked, and the observation is the car's
# motion and its goal.
FIRST = EnvConfig(
    num_agents=1,
    num_parked_cars=0,
    physics="bicycle",
    spawn=SpawnConfig(close_ratio=0.0, reverse_ratio=1.0),
    episode=EpisodeConfig(max_steps=100, parked_rule="tanner"),  # 20 s
    observation=ContinuousObservation(
        tracked_agents=0, tracked_parked_cars=0, rings=RingConfig(()), rays=RayConfig(0)
    ),
)

# The tasks of Tanner 2022 for real cars: all else is the default environment's.
SQUARE = EnvConfig(
    layout="square",
    num_agents=7,
    num_parked_cars=16,
    reward=RewardConfig(closeness=0.0),
)
DYNAMIC = dataclasses.replace(
    SQUARE, goals=GoalConfig(dynamic=True, num_tracked_bays=1)
)

# Lots of every family, some or many cars of all kinds, imperfect sensors. Exploration
# finds tight bays too rarely to begin with: more pay for the way into the bay.
_CARS = ("city", "compact", "sedan", "sedan_fwd", "suv", "van")
OBSERVATION = ContinuousObservation(
    tracked_agents=7,
    tracked_parked_cars=6,
    share=ShareConfig(steering=True, priority=True),
    own_car=True,
    lines=True,
    route=True,
    rays=RayConfig(72, near=1.0),  # one every 5 degrees, twice: far and near
)
ANYWHERE = EnvConfig(
    layout="square,square_compact,street,street_parallel,angled,lot,garage_row,dead_end",
    num_agents=8,
    min_agents=1,
    num_parked_cars=20,
    occupancy=(0.2, 0.8),
    fleet=FleetConfig(agents=_CARS, parked_cars=_CARS),
    jitter=JitterConfig(along=(-0.3, 0.3), across=(-0.1, 0.1), heading=(-0.05, 0.05)),
    episode=EpisodeConfig(max_steps=300),  # 60 s: lots of up to 100 m
    reward=RewardConfig(
        park=8.0,
        progress=0.4,
        route=True,
        reeds_shepp_reach=20.0,
        alignment=0.0,
        closeness=0.0,
        time=2.5,  # high: penalises waiting
    ),
    observation=OBSERVATION,
    # [est] of loaded or worn cars on a dry or wet surface.
    randomization=RandomizationConfig(
        mass=(0.9, 1.2),
        friction=(0.7, 1.1),
        tyre_stiffness=(0.8, 1.2),
        brake_gain=(0.8, 1.2),
        steering_offset=(-0.01, 0.01),
        steering_lag=(0.0, 0.1),
    ),
    # [est] of a good localisation, a step late at most.
    sensors=SensorConfig(
        position_noise=0.02, heading_noise=0.005, speed_noise=0.05, delay_max=1
    ),
)

# Up to four cars among people with varying attention, carts, and drivers.
# Waiting takes time, so episodes are longer; hitting a person costs `person` besides
# the crash. Cars have emergency braking: what remains to learn is to get on without it.
CONSIDERATE = dataclasses.replace(
    ANYWHERE,
    num_agents=4,
    movers=(
        "pedestrians:number=0..20,attention=0.5..1.0",
        *("cart", "cart"),
        "drivers:number=2",
    ),
    sim=SimConfig(emergency_brake=0.3),
    episode=EpisodeConfig(max_steps=600),  # 120 s
    reward=dataclasses.replace(
        ANYWHERE.reward, time=3.0, extra={"person": 5.0, "comfort": 4.0}
    ),
    observation=dataclasses.replace(OBSERVATION, tracked_agents=3, tracked_movers=6),
)
# The same with cameras: others, the lot and the bay are seen by four cameras; the own
# motion is measured, and a route leads on until the bay is in view.
SEES = dataclasses.replace(
    ANYWHERE,
    num_agents=4,
    observation=CameraObservation(
        tracked_agents=0,
        tracked_parked_cars=0,
        own_car=True,
        route=True,
        rings=RingConfig(),
        rays=RayConfig(),
        width=48,
        height=36,
        reach=12.0,
        goal="seen",
    ),
)

ENVIRONMENTS.register("first", FIRST)
ENVIRONMENTS.register("square", SQUARE)
ENVIRONMENTS.register("dynamic", DYNAMIC)
ENVIRONMENTS.register("anywhere", ANYWHERE)
ENVIRONMENTS.register("considerate", CONSIDERATE)
ENVIRONMENTS.register("sees", SEES)


def environment(name: str) -> EnvConfig:
    """The environment of that name; `ValueError` of an unknown one lists the known."""
    return ENVIRONMENTS[name]
