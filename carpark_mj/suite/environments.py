"""Environments of the suite, and PPO's presets: HOPE's levels; any car in any scene."""

import dataclasses

import carpark_mj.suite.hope  # noqa: F401  # pyright: ignore[reportUnusedImport]
from carpark_mj.config import (
    EpisodeConfig,
    FleetConfig,
    JitterConfig,
    RandomizationConfig,
    RayConfig,
    SensorConfig,
    SimConfig,
    SpawnConfig,
)
from carpark_mj.config.networks import NetworkConfig
from carpark_mj.extensions import Entry
from carpark_mj.layouts import mixture
from carpark_mj.layouts.base import LAYOUTS, register_layout
from carpark_mj.layouts.stored import ScaledConfig
from carpark_mj.observations import ContinuousObservation
from carpark_mj.registry import ANYWHERE, ENVIRONMENTS, OBSERVATION
from carpark_mj.training.ppo import presets
from carpark_mj.training.ppo.parts import PRESETS

# HOPE's levels (docs/hard_cases.md): one car without noise among boxes, seen by rays.
HOPE = dataclasses.replace(
    ANYWHERE,
    layout="hope_normal_perpendicular,hope_normal_parallel,hope_complex_perpendicular,"
    "hope_complex_parallel,hope_extreme_parallel",
    vehicle="tpcap",
    num_agents=1,
    min_agents=None,
    num_parked_cars=0,
    occupancy=None,
    fleet=FleetConfig(),
    jitter=JitterConfig(),
    spawn=SpawnConfig(close_ratio=0.0),
    episode=EpisodeConfig(max_steps=500),  # 100 s, as in the suite
    observation=ContinuousObservation(
        tracked_agents=0,
        tracked_parked_cars=0,
        own_car=True,
        lines=True,
        rays=RayConfig(72, near=1.0),
    ),
    randomization=RandomizationConfig(),
    sensors=SensorConfig(),
)

# Cars of all sizes, each mostly where it has little room: in lots of every family, in
# HOPE's levels and among pieces of outlines, at the scale of other cars. Tight bays
# take several moves. Where there is room for them, other cars and people are about.
_MEMBERS = {
    **dict.fromkeys(str(ANYWHERE.layout).split(","), (2.5, (0.95, 1.5))),
    **dict.fromkeys(str(HOPE.layout).split(","), (1.0, (0.72, 1.3))),
    "hope_extreme_parallel": (3.0, (0.72, 1.3)),
    "clutter_sizes": (3.0, (0.95, 1.05)),
    "clutter_sizes_tight": (3.0, (0.95, 1.05)),
    "clutter_parallel": (3.0, (0.95, 1.05)),
    "clutter_vans": (2.0, (0.95, 1.0)),
}
register_layout(
    "valet",
    mixture(
        [ScaledConfig(LAYOUTS[name], scale) for name, (_, scale) in _MEMBERS.items()],
        [weight for weight, _ in _MEMBERS.values()],
    ),
)
VALET = dataclasses.replace(
    ANYWHERE,
    layout="valet",
    num_agents=4,
    movers=("pedestrians:number=0..6,attention=0.5..1.0", "cart", "drivers:number=1"),
    sim=SimConfig(emergency_brake=0.3, manoeuvre_brake=0.01),
    fleet=FleetConfig(
        # HOPE's and TPCAP's car is drawn as often as 8 of the others.
        agents=("range:128", *8 * ("tpcap",)),
        parked_cars=ANYWHERE.fleet.parked_cars,
        snug=0.5,
    ),
    episode=EpisodeConfig(max_steps=500, parked_rule="exact"),  # 100 s
    reward=dataclasses.replace(
        ANYWHERE.reward, extra={"person": 5.0, "automatic_braking": 0.05}
    ),
    observation=dataclasses.replace(
        OBSERVATION,
        tracked_agents=3,
        tracked_movers=6,
        own_response=True,
        own_gear=True,
        own_past=True,
        delay_compensation=True,
    ),
    # [est] of a good localisation, a step late at most.
    sensors=SensorConfig(
        position_noise=0.01, heading_noise=0.003, speed_noise=0.03, delay_max=1
    ),
)

# HOPE's levels: one car alone, with nobody to collide with, and no set of cars to read.
HOPE_PPO = dataclasses.replace(
    presets.SQUARE,
    preset="hope",
    num_steps=2_400_000_000,
    lot_life=16,
    unroll_length=64,
    num_epochs=4,
    half_precision=False,
    curriculum=dataclasses.replace(
        presets.SQUARE.curriculum,
        crash_scale=2.0,
        conflict_ratio=0.0,
        reverse_ratio=0.5,
        target_rate=0.99,
    ),
    networks=NetworkConfig((256, 256, 256), (256, 256, 256), encoder="flat"),
    env=HOPE,
)

# Few cars in very different scenes. Drawing them compiles for minutes, so lots are
# stored. Most lots have one bay, so that a GPU has time for more than `anywhere` has.
VALET_PPO = dataclasses.replace(
    presets.ANYWHERE,
    preset="valet",
    num_steps=1_570_000_000,
    num_lots=16384,
    stored_lots=12_288,
    num_minibatches=64,
    curriculum=dataclasses.replace(
        presets.ANYWHERE.curriculum, reverse_ratio=0.4, neighbour_share=0.0
    ),
    env=VALET,
)

ENVIRONMENTS.register("hope", HOPE)
ENVIRONMENTS.register("valet", VALET)
PRESETS.register("hope", Entry("carpark_mj.suite.environments:HOPE_PPO", "GPU"))
PRESETS.register("valet", Entry("carpark_mj.suite.environments:VALET_PPO", "GPU"))
