"""All obstacles of a lot in one list."""

from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.geometry import rotate
from carpark_mj.geometry.obstacles import NO_MOVERS, Boxes, Discs, Group, Movers
from carpark_mj.layouts.types import Layout
from carpark_mj.types import Motion, ParkedCars


def lot_obstacles(
    layout: Layout,
    motion: Motion | None,
    parked_cars: ParkedCars,
    movers: Movers = NO_MOVERS,
) -> tuple[Group, ...]:
    """All obstacles of a lot, agents first.

    Args:
        layout: its walls and discs.
        motion: the agents; None = leave them out.
        parked_cars: where they stand.
        movers: where they are.
    """
    groups: list[Group] = []
    if motion is not None:
        velocity_w = rotate(motion.velocity_b, motion.pose_w[..., 2])
        groups.append(
            Boxes(
                motion.pose_w,
                motion.size,
                velocity_w,
                trace_w=motion.trace_w,
                kind=ObstacleKind.AGENT,
            )
        )
    groups += [
        Boxes(
            parked_cars.pose_w,
            parked_cars.size,
            mask=parked_cars.present,
            kind=ObstacleKind.PARKED_CAR,
        ),
        Boxes(
            layout.wall_pose,
            layout.wall_size,
            mask=layout.wall_mask,
            kind=ObstacleKind.WALL,
        ),
        Discs(
            layout.disc_centre,
            layout.disc_radius,
            mask=layout.disc_mask,
            kind=ObstacleKind.WALL,
        ),
    ]
    return (*groups, *movers.groups)
