"""The socket answers as the environment steps; bad requests get a sentence."""

import json
import socket
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.programs import exit_code

from carpark_formats import json_lines
from carpark_formats.json_lines import LineServer
from carpark_mj.config import EnvConfig, EpisodeConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts.files import parse_layout
from carpark_mj.spawning.reset_options import ResetOptions

CONFIG = EnvConfig(
    layout="square_compact",
    num_agents=1,
    num_parked_cars=3,
    physics="bicycle",
    episode=EpisodeConfig(respawn=False, max_steps=3),
)
START = {"pose": [[0.0, -2.0, 1.57]], "goal": [7], "seed": 3}


@pytest.fixture(scope="module")
def client():
    server = LineServer(ParkingEnv(CONFIG), 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with socket.create_connection(server.server_address) as connection:
        stream = connection.makefile("rw", encoding="utf-8")

        def ask(request):
            line = request if isinstance(request, str) else json.dumps(request)
            stream.write(f"{line}\n")
            stream.flush()
            return json.loads(stream.readline())

        yield ask
        server.shutdown()
        server.server_close()
        assert stream.readline() == ""  # it hangs up on a client that stays
        assert not server.clients


def test_a_client_drives_as_the_environment_steps(client):
    assert "reset" in client({"action": [[0.0, 0.0]]})["error"]
    env = ParkingEnv(CONFIG)
    options = ResetOptions(jnp.array(START["pose"]), goal=jnp.array(START["goal"]))
    reset = jax.jit(lambda key: env.reset(key, "test", options=options))
    state, seen = reset(jax.random.key(START["seed"]))
    answer, step = client({"reset": START}), jax.jit(env.step)
    layout = parse_layout(answer["layout"])
    np.testing.assert_allclose(layout.bay_pose, state.layout.bay_pose, atol=1e-6)
    assert answer["time"] == 0.0
    for count in range(1, 4):
        np.testing.assert_allclose(answer["observation"], seen, atol=1e-6)
        np.testing.assert_allclose(answer["pose"], state.motion.pose_w, atol=1e-6)
        cars = [obstacle["pose"] for obstacle in answer["obstacles"]]
        np.testing.assert_allclose(cars, state.parked_cars.pose_w, atol=1e-5)
        action = [[0.3, 0.8]]
        answer = client({"action": action})
        state, timestep = step(state, jnp.array(action))
        seen = timestep.observation
        np.testing.assert_allclose(answer["reward"], timestep.reward, atol=1e-6)
        assert answer["time"] == pytest.approx(count * CONFIG.sim.ctrl_dt)
        assert answer["done"] == (count == 3)
    assert answer["timed_out"] == [True]
    assert answer["speed"][0] > 0.1


def test_the_command_serves_the_lots_of_its_flags(monkeypatch):
    served = []

    class Once(LineServer):
        def serve_forever(self):
            served.append((self.server_address[1], self.env.config))

    monkeypatch.setattr(json_lines, "LineServer", Once)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    flags = "--layout square_compact --num-agents 1 --num-parked-cars 3"
    assert exit_code("serve", ["zero", *flags.split(), "--port", str(port)]) == 0
    [(at, config)] = served
    assert (at, config.num_agents, config.num_parked_cars) == (port, 1, 3)
    assert not config.episode.respawn
    taken = socket.create_server(("127.0.0.1", 0))
    with taken, pytest.raises(OSError, match="--port"):
        LineServer(ParkingEnv(config), taken.getsockname()[1])


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        ("nonsense", "JSON"),
        ({"stop": 1}, "reset"),
        ({"reset": {"place": 1}}, "place"),
        ({"reset": {"seed": -1}}, "seed"),
        ({"reset": {"pose": [[0.0, 0.0]]}}, "pose"),
        ({"reset": {"pose": [[1e3, 0.0, 0.0]]}}, "outside"),
        ({"reset": {"goal": [1000]}}, "goal"),
        ({"reset": START | {"speed": "fast"}}, "fast"),
    ],
    ids=str,
)
def test_bad_requests_are_answered_by_a_sentence(client, request_, said):
    assert said in client(request_)["error"]


def test_bad_actions_are_answered_by_a_sentence(client):
    client({"reset": START})
    nan, huge = float("nan"), 10**400
    for action in ([[0.0]], [[0.0, None]], "left", [[0.0, nan]], [[0.0, huge]]):
        assert "error" in client({"action": action}), action
