"""The car, the reward and the environments of Tanner 2022 (arXiv 2206.13338).

Tables follow appendix C of Tanner 2022. Where its text and the reference
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
  implementation means to spare tracked cars, but compares ids that are never equal.
  The text moves the one farthest from all agents, by which goals are lost half
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
- parking and crashing are terminal, a timeout is not: see `q_learning`.
"""

import dataclasses

from carpark_mj.config import (
    REWARDS,
    WORLD_UNIT,
    EnvConfig,
    EpisodeConfig,
    GoalConfig,
    RewardConfig,
    RingConfig,
    SpawnConfig,
)
from carpark_mj.registry import ENVIRONMENTS
from carpark_mj.vehicle import COMPACT, register_vehicle
from carpark_papers.tanner.indices import IndexObservation
from carpark_papers.tanner.observation import TannerObservation

# 7.9 x 3.9 world units: the colliders are 0.1 smaller than what is drawn.
register_vehicle(
    "tanner",
    dataclasses.replace(COMPACT, length=7.9 * WORLD_UNIT, width=3.9 * WORLD_UNIT),
)


TANNER = RewardConfig(
    park=1.0,
    crash=1.0,
    time=0.2,
    progress=0.0,
    alignment=0.0,
    closeness=0.0,
    extra={"approach": 0.15, "smoothness": 0.05, "reverse": 0.1},
)
REWARDS.register("tanner", TANNER)


# Tables C.1 and C.2; 216 table entries: 3 levels of speed, 8 bearings, 9 actions.
TANNER_QLEARNING = EnvConfig(
    layout="square",
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
    layout="square",
    vehicle="tanner",
    num_agents=7,
    num_parked_cars=16,
    physics="grid",
    spawn=SpawnConfig(
        close_ratio=0.2,
        close_distance=10 * WORLD_UNIT,
        conflict_ratio=0.2,
        conflict_distance=13.125 * WORLD_UNIT,
        min_distance=13.125 * WORLD_UNIT,
        max_redraws=1000,
        spacing=WORLD_UNIT / 16,
        relocation="any",
        kinds_at_reset=True,
    ),
    goals=GoalConfig(may_repeat=True),
    episode=EpisodeConfig(parked_rule="tanner", max_steps=200),
    reward=TANNER,
    observation=TannerObservation(),
)

# Table C.10, on top of C.9; the weights of goals are the defaults of `GoalRewards`.
TANNER_DYNAMIC = dataclasses.replace(
    TANNER_FIXED,
    goals=GoalConfig(dynamic=True, num_tracked_bays=1, slots_by_distance=True),
)

ENVIRONMENTS.register("tanner-fixed", TANNER_FIXED)
ENVIRONMENTS.register("tanner-dynamic", TANNER_DYNAMIC)
ENVIRONMENTS.register("tanner-qlearning", TANNER_QLEARNING)
ENVIRONMENTS.register("tanner-qlearning-recorded", TANNER_QLEARNING_RECORDED)
ENVIRONMENTS.register("tanner-qlearning-rings", TANNER_QLEARNING_RINGS)
