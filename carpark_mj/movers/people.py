"""The people of a lot: who they are and what they are about to do."""

import jax
from flax import struct

from carpark_mj.movers.places import Places


@struct.dataclass
class People:
    """The people of a lot, (n,).

    Attributes:
        xy: (n, 2) [m].
        velocity: (n, 2) [m/s].
        speed: desired speed [m/s].
        radius: [m].
        present: bool, whether there is such a person.
        child: bool, waits between parked cars and runs across.
        stands: bool, rests for long.
        straight: bool, walks straight whoever is near.
        attentive: bool, gives way to cars.
        leader: int32, whom the person walks with; itself if alone.
        offset: (n, 2) beside the leader's way [m].
        place: int32, where the walk began.
        target: int32, where it leads.
        phase: int32, of the walk, see `carpark_mj.movers.walking`.
        inside: bool, whether it ends between parked cars.
        clock: time since the phase began; negative = of rest left [s].
        halted: time without headway, on the way or by a car that waits [s].
        near: (6, n, k) `outlines` of parked cars and walls that are near.
        turn: () int32, whose are looked up next.
        places: of the lot.
    """

    xy: jax.Array
    velocity: jax.Array
    speed: jax.Array
    radius: jax.Array
    present: jax.Array
    child: jax.Array
    stands: jax.Array
    straight: jax.Array
    attentive: jax.Array
    leader: jax.Array
    offset: jax.Array
    place: jax.Array
    target: jax.Array
    phase: jax.Array
    inside: jax.Array
    clock: jax.Array
    halted: jax.Array
    near: jax.Array
    turn: jax.Array
    places: Places
