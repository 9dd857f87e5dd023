"""Which cameras of a scene a flag names; nothing heavy is imported."""

LOT_CAMERAS = ("topdown", "overview")
OFFSCREEN_WIDTH, OFFSCREEN_HEIGHT = 1920, 1080  # largest frame the renderer may ask for


def camera_names(camera: str, num_agents: int | None = None) -> tuple[str, ...]:
    """Names of the scene's cameras for a camera flag, left to right.

    `topdown`, `overview`, `chase:K` behind agent K, `driver:K` at its wheel, `split`
    (topdown and chase:0) or `split:K`; a `ValueError` of others lists these.
    `num_agents` is None if it is not known yet.
    """
    kind, colon, agent = str(camera).partition(":")
    known = agent.isdecimal() and (num_agents is None or int(agent) < num_agents)
    if camera in LOT_CAMERAS:
        return (camera,)
    if kind in ("chase", "driver") and known:
        return (f"agent{int(agent)}/{kind}",)
    if kind == "split" and (known or not colon):
        return ("topdown", f"agent{int(agent or 0)}/chase")
    last = "" if num_agents is None else f" to {num_agents - 1}"
    raise ValueError(
        f"unknown camera {camera!r}; choose topdown, overview, chase:K, driver:K, "
        f"split or split:K with K from 0{last}"
    )


def followed_agents(cameras: tuple[str, ...]) -> tuple[int, ...]:
    """The agents on whose cars some of the cameras are; none for the whole lot."""
    owners = [camera.partition("/")[0] for camera in cameras if "/" in camera]
    return tuple(int(owner.removeprefix("agent")) for owner in owners)
