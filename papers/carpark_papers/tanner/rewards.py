"""Weights of the study's reward, table C.9; potential-based terms are off."""

from carpark_mj.config import REWARDS, RewardConfig

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
