"""Environments of the suite: HOPE's levels, and one for any car in any scene."""

import dataclasses

from carpark_mj.config import (
    EpisodeConfig,
    FleetConfig,
    JitterConfig,
    RandomizationConfig,
    RayConfig,
    SensorConfig,
    SpawnConfig,
)
from carpark_mj.extensions import Entry
from carpark_mj.layouts import mixture
from carpark_mj.layouts.base import LAYOUTS, register_layout
from carpark_mj.layouts.stored import ScaledConfig
from carpark_mj.observations import ContinuousObservation
from carpark_mj.registry import ANYWHERE, ENVIRONMENTS, OBSERVATION
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
# take several moves.
_MEMBERS = {
    **dict.fromkeys(str(ANYWHERE.layout).split(","), (1.0, (0.95, 1.5))),
    **dict.fromkeys(str(HOPE.layout).split(","), (1.0, (0.72, 1.3))),
    "clutter_sizes": (3.0, (0.95, 1.05)),
    "clutter_sizes_tight": (3.0, (0.95, 1.05)),
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
    num_agents=1,
    min_agents=None,
    fleet=FleetConfig(
        # HOPE's and TPCAP's car is drawn as often as 8 of the others.
        agents=("range:128", *8 * ("tpcap",)),
        parked_cars=ANYWHERE.fleet.parked_cars,
        snug=0.5,
    ),
    episode=EpisodeConfig(max_steps=500, parked_rule="exact"),  # 100 s
    observation=dataclasses.replace(OBSERVATION, tracked_agents=0, own_response=True),
    # [est] of a good localisation.
    sensors=SensorConfig(position_noise=0.01, heading_noise=0.003, speed_noise=0.03),
)

ENVIRONMENTS.register("hope", HOPE)
ENVIRONMENTS.register("valet", VALET)
PRESETS.register("hope", Entry("carpark_mj.suite.presets:HOPE", "GPU"))
PRESETS.register("valet", Entry("carpark_mj.suite.presets:VALET", "GPU"))
