"""Environments by name: our own, and those of the studies behind this gym.

Tables are those of the appendix C of Tanner 2022. Where its text and the reference
implementation disagree, or do not say, the choice is:

- grid points per world unit: the position granularity squared, so 74 x 74 for 1.
- cars' boxes and walls: the colliders of the reference implementation, which differ
  from the drawing; cars are 0.1 world units smaller than drawn.
- no turning at standstill, all headings are drawn at spawns, and ring k has diameter k:
  as in the reference implementation, without its two bugs.
- episodes of table C.1 have 85 steps. The recorded runs of figure 5.1 are of an older
  implementation, in which cars turn at standstill and episodes have 70 steps: all
  returns are multiples of 1/140. `tanner-qlearning-recorded` has these two.
- weights of the table's defaults, time 0.5 and approach 1: they break the study's own
  rule (approach below time), but only they give the returns it reports.
- leaving the world counts as a crash: the outer walls are hit first.
- when an agent parks, any parked car moves, at random, as in all published runs: the
  implementation means to spare those that agents track, but compares ids that are never
  equal. The text moves the one farthest from all agents, by which goals are lost half
  as often; `SpawnConfig.relocation` has all three.
- an agent loses its goal when the bay is no longer among the num_tracked_bays nearest,
  not the n_track nearest (text). This has the reward of giving the goal up, and losing
  it to another agent that parks there has none (implementation; not in the text).
- tracked bays are numbered by distance at every step (implementation); in the text they
  keep their slots, `GoalConfig.slots_by_distance`.
- starts on a collision course: the other agent's distance to its own goal must be long
  enough, as the starting agent has no position yet. At a reset goals are not redrawn.
- starts are drawn until they keep their distance, 16,016 poses at most; a close start
  is one walk, and random if that ends too near to another agent (implementation).
- an agent's next goal may be its last one (implementation).
- larger hitboxes in training: until a number of agent steps, the counter that ends the
  training (the implementation compares another one and probably never switches back).
- parking and crashing are terminal, a timeout is not: see `train/q_learning.py`.
"""

import dataclasses

from carpark_mj.config import (
    REWARDS,
    WORLD_UNIT,
    ContinuousObservation,
    EnvConfig,
    EpisodeConfig,
    FleetConfig,
    GoalConfig,
    IndexObservation,
    JitterConfig,
    RandomizationConfig,
    RayConfig,
    RewardConfig,
    RingConfig,
    SensorConfig,
    ShareConfig,
    SimConfig,
    SpawnConfig,
    TannerObservation,
)

# Tables C.1 and C.2; 216 table entries: 3 levels of speed, 8 bearings, 9 actions.
TANNER_QLEARNING = EnvConfig(
    layout="tanner",
    vehicle="tanner",
    num_agents=1,
    num_parked_cars=0,
    physics="grid_coarse",
    spawn=SpawnConfig(
        close_ratio=0.0,
        min_distance=9 * WORLD_UNIT,
        spacing=WORLD_UNIT,
        relocation="any",
    ),
    goals=GoalConfig(may_repeat=True),
    episode=EpisodeConfig(parked_rule="tanner", max_steps=85),
    reward=RewardConfig(
        park=10.0,
        crash=10.0,
        time=0.5,
        progress=0.0,
        alignment=0.0,
        closeness=0.0,
        extra={"approach": 1.0},
    ),
    observation=IndexObservation(),
)

# As the runs of figure 5.1 were recorded.
TANNER_QLEARNING_RECORDED = dataclasses.replace(
    TANNER_QLEARNING,
    physics="grid_recorded",
    episode=dataclasses.replace(TANNER_QLEARNING.episode, max_steps=70),
)

# Figure 5.2: every bay but the goal taken, rings of 14, 11, 10, 6 and 7 world units.
TANNER_QLEARNING_RINGS = dataclasses.replace(
    TANNER_QLEARNING,
    num_parked_cars=35,
    observation=IndexObservation(
        RingConfig(tuple(d * WORLD_UNIT for d in (14, 11, 10, 6, 7)), cap=1, cars=True)
    ),
)

# Table C.9: the study's PPO, 7 agents on the fine grid.
TANNER_FIXED = EnvConfig(
    layout="tanner",
    vehicle="tanner",
    num_agents=7,
    num_parked_cars=16,
    physics="grid",
    spawn=SpawnConfig(
        close_ratio=0.2,
        close_distance=10 * WORLD_UNIT,
        crash_ratio=0.2,
        crash_distance=13.125 * WORLD_UNIT,
        min_distance=13.125 * WORLD_UNIT,
        max_redraws=1000,
        spacing=WORLD_UNIT / 16,
        relocation="any",
        kinds_at_reset=True,
    ),
    goals=GoalConfig(may_repeat=True),
    episode=EpisodeConfig(parked_rule="tanner", max_steps=200),
    reward=REWARDS["tanner"],
    observation=TannerObservation(),
)

# Table C.10, on top of C.9; the weights of goals are the defaults of `GoalRewards`.
TANNER_DYNAMIC = dataclasses.replace(
    TANNER_FIXED,
    goals=GoalConfig(dynamic=True, num_tracked_bays=1, slots_by_distance=True),
)

# The same tasks for real cars: everything else is the default environment's.
SQUARE = EnvConfig(
    layout="tanner",
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
ANYWHERE = EnvConfig(
    layout="tanner,compact,street,street_parallel,angled,lot,garage_row,dead_end",
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
        reeds_shepp=20.0,
        alignment=0.0,
        closeness=0.0,
        time=2.5,  # dear, against standing where they might turn either way
    ),
    observation=ContinuousObservation(
        tracked_agents=7,
        tracked_parked_cars=6,
        share=ShareConfig(steering=True, order=True),
        own_car=True,
        lines=True,
        route=True,
        rays=RayConfig(72),  # one every 5 degrees
    ),
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
        rays=RayConfig(72),
    ),
    randomization=RandomizationConfig(),
    sensors=SensorConfig(),
)

# Pandita 2022: highway-env's car in a lot where all other slots are taken; 150 steps at
# 5 Hz. With goal poses, reward and ends of `carpark_mj.wrappers.slots`.
PANDITA = EnvConfig(
    layout="slots",
    vehicle="highway",
    num_agents=1,
    num_parked_cars=11,
    physics="highway",
    sim=SimConfig(sim_dt=1 / 15, trace_dt=1 / 15),
    spawn=SpawnConfig(close_ratio=0.0),
    episode=EpisodeConfig(max_steps=150),
)
# The same for real cars.
SLOTS = dataclasses.replace(PANDITA, vehicle="compact", physics="mjx", sim=SimConfig())

# MetaDrive's multi-agent parking lot: 10 agents, 100 s; docs/metadrive.md says what
# differs. Starts keep a car's length apart, or as far as they can.
METADRIVE = EnvConfig(
    layout="metadrive",
    num_agents=10,
    num_parked_cars=0,
    goals=GoalConfig(drive_out=True),
    spawn=SpawnConfig(close_ratio=0.0, min_distance=4.6, num_candidates=64),
    episode=EpisodeConfig(parked_rule="metadrive", max_steps=500),
)

ENVIRONMENTS: dict[str, EnvConfig] = {
    "square": SQUARE,
    "dynamic": DYNAMIC,
    "anywhere": ANYWHERE,
    "hope": HOPE,
    "tanner-fixed": TANNER_FIXED,
    "tanner-dynamic": TANNER_DYNAMIC,
    "tanner-qlearning": TANNER_QLEARNING,
    "tanner-qlearning-recorded": TANNER_QLEARNING_RECORDED,
    "tanner-qlearning-rings": TANNER_QLEARNING_RINGS,
    "slots": SLOTS,
    "pandita": PANDITA,
    "metadrive": METADRIVE,
}


def environment(name: str) -> EnvConfig:
    """Looks a named environment up.

    Raises:
        ValueError: unknown name; the message lists the known ones.
    """
    if name not in ENVIRONMENTS:
        raise ValueError(
            f"unknown environment {name!r}; choose from {sorted(ENVIRONMENTS)}"
        )
    return ENVIRONMENTS[name]
