"""Settings of policies' networks."""

import dataclasses
from typing import Annotated, Literal

from carpark_mj.config.checks import (
    Bounds,
    CheckedConfig,
    Count,
    Natural,
    NonNegative,
    Positive,
)

MIN_STD = 0.001  # of actions before tanh; Brax's


@dataclasses.dataclass(frozen=True)
class NetworkConfig(CheckedConfig):
    """Sizes of the networks; activations are swish.

    Attributes:
        policy_layers: sizes of the actor's hidden layers.
        value_layers: sizes of the critic's hidden layers.
        encoder: encoder before the layers. `set`: shared layers for all cars of
            a kind, see `carpark_mj.policy.encoder`; the weights fit any number of cars.
            `flat`: none, the layers read the vector.
        own_size: features of the agent's own numbers in `set`.
        entity_size: features of a set of entities in `set`.
        picture_size: features of each camera's picture in `set`.
        min_std: least standard deviation of continuous actions before tanh, above 0.
            With a small value a policy may stop exploring.
        max_std: largest such deviation; 0 = no limit. A policy that depends on its
            noise drives worse without it.
        bins: values at equal distances that each continuous action is chosen from,
            instead of any by a normal distribution; 0 = any.
        dither: time of an episode [s] after which a policy that takes the likeliest
            `bins` adds noise, so that it ends what it would repeat for ever; 0 = none.
        mirrored: whether such a policy averages over the scene and its mirror image, so
            that it drives alike to the left and to the right.
    """

    policy_layers: Annotated[tuple[int, ...], Bounds(ge=1)] = (128, 128)
    value_layers: Annotated[tuple[int, ...], Bounds(ge=1)] = (128, 128)
    encoder: Literal["set", "flat"] = "set"
    own_size: Count = 128
    entity_size: Count = 64
    # The first convolution has half as many channels.
    picture_size: Annotated[int, Bounds(ge=2)] = 64
    min_std: Positive = MIN_STD
    max_std: NonNegative = 0.0
    bins: Natural = 0
    dither: NonNegative = 0.0
    mirrored: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_std and self.max_std < self.min_std:
            raise ValueError(
                f"max_std {self.max_std} must be 0 or at least min_std {self.min_std}"
            )
        if self.bins == 1:
            raise ValueError("bins must be 0 or at least 2, not 1")
        if (self.dither or self.mirrored) and not self.bins:
            raise ValueError("dither and mirrored need bins")
