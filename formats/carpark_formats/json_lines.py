"""A lot over a local socket: JSON objects, one a line, for programs in any language.

A client connects, sends one request a line and reads one answer a line:

    {"reset": {"seed": 0, "pose": [[0.0, -2.0, 1.57]], "goal": [7]}}
    {"action": [[0.1, 0.5]]}

Every entry of `reset` is optional. An action is steer and pedal in [-1, 1] of each
agent. Answers have the time [s], and for each agent its pose [m, m, rad], speed [m/s],
steering angle [rad], the pose of its goal and its observation; parked cars and movers
as boxes; that of a reset the layout, as in a layout file; that of a step rewards, how
episodes ended and whether all have. A bad request is answered by {"error": "..."}.
"""

import contextlib
import dataclasses
import json
import socket
import socketserver
from collections.abc import Mapping
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from carpark_formats.settings import ServeConfig
from carpark_mj.cli.clock import wait_for_user
from carpark_mj.cli.driver import adapted, find_driver
from carpark_mj.config.checks import require_seed
from carpark_mj.env import ParkingEnv
from carpark_mj.extensions import unknown_name
from carpark_mj.geometry.obstacles import Boxes
from carpark_mj.layouts.files import layout_text
from carpark_mj.reading import parse_object
from carpark_mj.rendering.local_pages import listening
from carpark_mj.spawning.reset_options import ResetOptions, check_starts
from carpark_mj.types import NO_BAY, OUTCOMES, State

HOST = "127.0.0.1"
OPTIONS = ("seed", "pose", "speed", "goal")
Answer = dict[str, Any]


def serve(config: ServeConfig) -> None:
    """Serves lots to programs until it is interrupted."""
    env = adapted(config, find_driver(config.run).env)
    episode = dataclasses.replace(env.episode, respawn=False)
    lots = ParkingEnv(dataclasses.replace(env, episode=episode))
    with LineServer(lots, config.port) as server:
        address = ":".join(map(str, server.server_address))
        print(f"serving {address}, one JSON object a line (Ctrl-C ends)", flush=True)
        wait_for_user()
        server.serve_forever()


class LineProtocol:
    """Answers requests about one lot, whose agents stay where their episodes end."""

    def __init__(self, env: ParkingEnv) -> None:
        """Takes an environment; `reset` and `step` compile at their first requests."""
        self.env = env
        self._state: State | None = None
        self._steps = 0  # since the reset
        self._reset = jax.jit(lambda key, given: env.reset(key, "test", options=given))
        self._step = jax.jit(env.step)

    def answer(self, line: str) -> Answer:
        """The answer to a line."""
        try:
            request = parse_object(line, "the request")
            if list(request) == ["reset"]:
                return self._begin(request["reset"])
            if list(request) == ["action"]:
                return self._act(request["action"])
            raise ValueError('a request is {"reset": {...}} or {"action": [...]}')
        except (ValueError, TypeError, OverflowError) as error:
            return {"error": str(error)}

    def _begin(self, given: Any) -> Answer:
        if not isinstance(given, Mapping):
            raise ValueError(f"reset must be an object, not {given!r}")
        values = dict(cast(Mapping[str, Any], given))
        for name in values:
            if name not in OPTIONS:
                raise ValueError(unknown_name("entry of reset", name, OPTIONS))
        seed = values.pop("seed", 0)
        require_seed(seed)
        arrays = {
            name: jnp.asarray(value, jnp.int32 if name == "goal" else jnp.float32)
            for name, value in values.items()
        }
        options = ResetOptions(**arrays)
        state, seen = self._reset(jax.random.key(seed), options)
        check_starts(self.env.config, options, state)
        self._state, self._steps = state, 0
        layout = json.loads(layout_text(jax.device_get(state.layout)))
        return self._measured(seen) | {"layout": layout}

    def _act(self, action: Any) -> Answer:
        if self._state is None:
            raise ValueError("reset the lot first")
        spec = self.env.action_spec
        values = np.asarray(action, spec.dtype)
        shape = (self.env.num_agents, spec.size)
        if values.shape != shape or not np.isfinite(values).all():
            raise ValueError(f"action must be finite numbers of shape {list(shape)}")
        state, timestep = self._step(self._state, values)
        self._state, self._steps = state, self._steps + 1
        ends = {name: getattr(timestep.events, name).tolist() for name in OUTCOMES}
        done = not bool(state.active.any())
        rewards = {"reward": timestep.reward.tolist(), "done": done}
        return self._measured(timestep.observation) | rewards | ends

    def _measured(self, seen: jax.Array) -> Answer:
        state: Any = jax.device_get(self._state)
        motion, cars = state.motion, state.parked_cars
        boxes = [(cars.pose_w, cars.size, cars.bay != NO_BAY)]
        for group in state.movers.groups:
            size, pose = group.size, group.pose_w
            if not isinstance(group, Boxes):  # a disc as a square
                size = np.repeat(2.0 * size[:, None], 2, axis=1)
                pose = np.pad(pose, ((0, 0), (0, 1)))
            there = np.ones(len(pose), bool) if group.mask is None else group.mask
            boxes.append((pose, size, there))
        obstacles = [
            {"pose": pose.tolist(), "size": size.tolist()}
            for group in boxes
            for pose, size, there in zip(*group, strict=True)
            if there
        ]
        return {
            "time": round(self._steps * self.env.config.sim.ctrl_dt, 6),
            "pose": motion.pose_w.tolist(),
            "speed": motion.speed.tolist(),
            "steering": motion.steering.tolist(),
            "goal": [
                None if bay == NO_BAY else state.layout.parked_pose[bay].tolist()
                for bay in state.goal
            ],
            "observation": np.asarray(seen).tolist(),
            "obstacles": obstacles,
        }


class LineServer(socketserver.ThreadingTCPServer):
    """Serves clients of this machine; each has a lot of its own."""

    allow_reuse_address = True

    def __init__(self, env: ParkingEnv, port: int) -> None:
        """Listens at a port; 0 = any free one, see `server_address`."""
        self.env, self.clients = env, set[socket.socket]()
        with listening(port):
            super().__init__((HOST, port), _Client)

    def server_close(self) -> None:
        """Ends all connections and waits for their threads, which use JAX."""
        for client in [*self.clients]:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)
        super().server_close()


class _Client(socketserver.StreamRequestHandler):
    def handle(self) -> None:
        server = cast(LineServer, self.server)
        server.clients.add(self.request)
        protocol = LineProtocol(server.env)
        with contextlib.suppress(ConnectionError):  # the client has gone
            for line in self.rfile:
                answer = json.dumps(protocol.answer(line.decode("utf-8", "replace")))
                self.wfile.write(answer.encode() + b"\n")
        server.clients.discard(self.request)
