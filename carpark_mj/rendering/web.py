"""A lot in the browser, through mjviser: driven by sliders, or live by a policy."""

import dataclasses
import functools
import math
import threading
from collections.abc import Callable, Iterator
from typing import Any

import jax
import mujoco
import numpy as np

from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.keys import evaluation_key
from carpark_mj.layouts.types import VERGE_GAP
from carpark_mj.mdp.parked_cars import AWAY
from carpark_mj.policy import acting
from carpark_mj.rendering.recording import aimed_at, parked_trace
from carpark_mj.rendering.stage import Snapshot, Stage
from carpark_mj.scene.cameras import LEAST_ASPECT, frame_lot
from carpark_mj.scene.looks import ASPHALT, agent_colour, rgb
from carpark_mj.scene.parts import GROUND, yaw_quat
from carpark_mj.types import ENDINGS, State


class LiveLot:
    """A lot, its cars on a `Stage` at the present instant, and the policy that drives.

    `seconds` have been simulated, and `traces` poses are traced in a control step.
    """

    note = ""  # what has last happened, a sentence

    def __init__(self, env: ParkingEnv, policy: acting.AnyPolicy, seed: int) -> None:
        """Starts a lot, of those for training; compiles the reset alone."""
        self._env, self._policy = env, acting.as_argument(policy)
        reset_key, self._key = jax.random.split(evaluation_key(seed))
        self._step = jax.jit(self._control_step)
        self._start = acting.Carry(*jax.jit(env.reset)(reset_key))
        state = self._start.state
        self.extent = np.asarray(state.layout.extent)
        self._layout = jax.device_get(state.layout)
        self._shows = np.flatnonzero(state.takes_part)
        self.stage = Stage.of(env, state, len(self._shows))
        self.traces = state.motion.trace_w.shape[-2]
        # One call of `step` is one traced pose.
        self.stage.model.opt.timestep = env.config.sim.ctrl_dt / self.traces
        self.reset()

    def _control_step(self, policy, carry, key):
        carry, step = acting.control_step(self._env, acting.acts(policy), carry, key)
        timestep, motion = step.timestep, step.timestep.motion
        seen = {
            "pose_w": motion.trace_w[self._shows].swapaxes(0, 1),
            "steering": motion.steering[self._shows],
            "kind": self._kind(step.before),
            "parked_pose": parked_trace(step.before, step.after, motion),
            "goal": step.after.goal[self._shows],
            "movers": step.after.movers.groups,
            **self._record(step),
            **{name: getattr(timestep.events, name).sum() for name in ENDINGS},
        }
        return carry, seen

    def _record(self, step: acting.Step) -> dict[str, jax.Array]:
        """What else to keep of a control step, by name; nothing here."""
        return {}

    def compile_step(self) -> None:
        """Compiles what `step` runs; else its first call does."""
        self._step(self._policy, self._start, self._key)

    def reset(self) -> None:
        """Restarts the lot with the same random keys."""
        self._carry = self._start
        state = self._start.state
        self._steps = self._trace = 0
        self._seen = None
        self._ended = dict.fromkeys(ENDINGS, 0)
        self.seconds = 0.0
        self.stage.reset()
        own = state.motion.pose_w, state.motion.steering, state.goal
        pose_w, steering, goal = (np.asarray(x)[self._shows] for x in own)
        cars = np.asarray(state.parked_cars.pose_w), self._kind(state)
        self._place(pose_w, steering, goal, *cars, state.movers.groups)

    def _kind(self, state: State) -> jax.Array | None:
        """Which kinds of cars (agents,) are driven; None if there is one."""
        return None if state.kind is None else state.kind[self._shows]

    @property
    def begins(self) -> bool:
        """Whether the next call of `step` begins a control step."""
        return self._seen is None or self._trace == len(self._seen["pose_w"])

    def step(self) -> bool:
        """Advances by one traced pose; True if a control step has begun with it."""
        begins = self.begins
        if begins:
            key = jax.random.fold_in(self._key, self._steps)
            self._carry, seen = self._step(self._policy, self._carry, key)
            self._seen = jax.device_get(seen)
            self._steps, self._trace = self._steps + 1, 0
            self.seconds = self._steps * self._env.config.sim.ctrl_dt
            for name in ENDINGS:
                self._ended[name] += int(self._seen[name])
        seen = self._seen
        assert seen is not None
        pose, parked = (seen[name][self._trace] for name in ("pose_w", "parked_pose"))
        movers = tuple(group.instant(self._trace) for group in seen["movers"])
        own = pose, seen["steering"], seen["goal"]
        self._place(*own, parked, seen["kind"], movers)
        self._trace += 1
        return begins

    def snapshot(self) -> Snapshot:
        """The present instant, as pictures show it."""
        return dataclasses.replace(self._shown, tally=dict(self.tally()))

    def _place(
        self, pose_w: Any, steering: Any, goal: Any, parked: Any, kind: Any, movers: Any
    ) -> None:
        goal_pose, goal_size = aimed_at(self._layout, goal)
        self._shown = Snapshot(
            seconds=self.seconds,
            pose_w=pose_w,
            steering=steering,
            goal_pose=goal_pose,
            goal_size=goal_size,
            parked_pose=parked,
            active=np.abs(pose_w[:, 0]) < AWAY / 2,  # waiting agents are absent
            state=("",) * len(pose_w),
            kind=kind,
            movers=movers,
        )
        self.stage.place(self._shown)

    def tally(self) -> Iterator[tuple[str, float]]:
        """Episodes ended so far, by outcome."""
        return iter(self._ended.items())


DAYLIGHT = 0.3  # of the environment
GAMMA = 2.2  # of screens
FIELD_OF_VIEW = math.radians(60.0)  # mjviser's
_SLAB = 0.05  # m, thickness of the asphalt in the browser


def make_viewer(
    server: Any,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    extent: np.ndarray,
    step: Callable[..., None] | None = None,  # of model and data
    reset: Callable[..., None] | None = None,
) -> Any:
    """Shows a scene on a page of viser's server; `run()` keeps it moving.

    `extent` (2,) has half widths of the lot [m]; `step` advances the data by a time
    step, `reset` restarts, both MuJoCo's own if None. Returns mjviser's viewer.
    """
    import mjviser

    # mjviser prefers a material's colour to the geom's own, which is the car's.
    model.geom_matid[:] = -1
    # Its meshes travel as glTF, where colours of points are linear.
    model.geom_rgba[:, :3] **= GAMMA
    viewer = mjviser.Viewer(model, data, step_fn=step, reset_fn=reset, server=server)
    viewer.scene.camera_tracking_enabled = False
    server.scene.configure_environment_map(environment_intensity=DAYLIGHT)
    # Planes become grids there, so asphalt replaces the ground.
    server.scene.remove_by_name(f"/fixed_bodies/world/{GROUND}")
    server.scene.add_box(
        "/asphalt",
        rgb(ASPHALT),
        (2 * (extent[0] + VERGE_GAP), 2 * (extent[1] + VERGE_GAP), _SLAB),
        position=(0.0, 0.0, -_SLAB / 2),
        cast_shadow=False,
    )
    eye, _ = frame_lot("overview", extent, LEAST_ASPECT)
    viewer.scene.update_from_mjdata(data)

    @server.on_client_connect  # before `run`, too
    def _(client: Any) -> None:
        client.camera.fov = FIELD_OF_VIEW
        client.camera.position, client.camera.look_at = 0.65 * eye, model.stat.center

    # mjviser sets its camera when it runs and when a browser connects, from these.
    viewer.scene.create_scene_gui = functools.partial(
        viewer.scene.create_scene_gui,
        camera_distance=0.65 * float(np.linalg.norm(eye)),
        camera_azimuth=math.degrees(math.atan2(-eye[1], -eye[0])),
        camera_elevation=45.0,
    )
    return viewer


def make_live_viewer(server: Any, lot: LiveLot) -> Any:
    """Shows a lot in which a policy drives; see `make_viewer`."""
    goals: list[Any] = []
    restarting = threading.Event()

    def show() -> None:
        seen = lot.snapshot()
        marks = zip(goals, seen.goal_pose, seen.goal_size, strict=True)
        for goal, pose, size in marks:
            goal.visible = bool(np.isfinite(pose).all())
            if not goal.visible:  # the agent explores
                continue
            goal.dimensions = (float(size[0]) - 0.3, float(size[1]) - 0.3, 0.02)
            goal.position = (float(pose[0]), float(pose[1]), 0.0)
            goal.wxyz = yaw_quat(float(pose[2]))
        words = ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in lot.tally())
        tally.content = f"**{lot.seconds:.0f} s**: {words}\n\n{lot.note}"

    def step(*scene: Any) -> None:
        if restarting.is_set():
            restarting.clear()
            reset(*scene)
        elif lot.step():
            show()

    def reset(*scene: Any) -> None:
        lot.reset()
        show()

    stage = lot.stage
    viewer = make_viewer(server, stage.model, stage.data, lot.extent, step, reset)
    add_box = functools.partial(server.scene.add_box, opacity=0.5, cast_shadow=False)
    agents = range(stage.num_agents)
    goals += [add_box(f"/goals/{k}", rgb(agent_colour(k))) for k in agents]
    tally = server.gui.add_markdown("")
    add_key(server, "Restart", "R", restarting.set)
    show()
    return viewer


def add_key(server: Any, label: str, key: str, act: Callable[[], None]) -> None:
    """Lets a key do something on a page, where viser has keys."""
    if hasattr(server.gui, "add_command"):
        command = server.gui.add_command(f"{label} ({key})", hotkey=key)
        command.on_trigger(lambda _: act())
