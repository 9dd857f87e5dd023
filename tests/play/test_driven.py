"""Lots driven by hand: keys, gamepads, who drives what, recording and replay."""

import contextlib
import json

import numpy as np
import pytest
from helpers.mutating import with_junk
from helpers.programs import assert_refused

from carpark_mj.cli.pages import open_page
from carpark_mj.cli.play import (
    PlayConfig,
    main,
    make_env,
    make_wheel,
    pad,
    replay,
    save,
)
from carpark_mj.play.demonstration import STEPS, load_demonstration
from carpark_mj.play.driving import (
    KEY_PEDAL,
    KEYS,
    STEER_RATE,
    Controls,
    DrivenLot,
    from_gamepad,
    from_keys,
    stop,
)
from carpark_mj.types import ENDINGS

STEPS_DRIVEN = 6


def swerve(lot):
    """Another action at every step."""
    return np.float32([[np.sin(5 * lot.seconds), 0.8]])


@pytest.fixture(scope="module")
def lot():
    env, others = make_env(PlayConfig(num_agents=2, num_parked_cars=3))
    return DrivenLot(env, others, 0, swerve)


def drive(lot, steps=STEPS_DRIVEN):
    lot.reset()
    for _ in range(steps * lot.traces):
        lot.step()
    return lot.demonstration


def test_only_the_first_car_obeys_the_driver(lot):
    drive(lot)
    found = lot.demonstration
    moved = np.abs(found.next_poses[-1] - found.poses[0])[:, :2]
    assert moved[0].max() > 0.3
    assert moved[1].max() < 1e-3
    assert lot.speed > 0.5


def test_everything_is_recorded(lot):
    drive(lot)
    found = lot.demonstration
    assert len(found) == STEPS_DRIVEN
    assert found.observations.shape[:2] == found.rewards.shape == (STEPS_DRIVEN, 2)
    assert found.poses.shape == (STEPS_DRIVEN, 2, 3)
    asked = [[np.sin(5 * 0.2 * k), 0.8] for k in range(STEPS_DRIVEN)]
    np.testing.assert_allclose(found.actions[:, 0], asked, atol=1e-5)
    assert not found.actions[:, 1].any()
    assert lot.score == pytest.approx(found.rewards[:, 0].sum(), abs=1e-5)
    assert dict(lot.tally())["score"] == round(lot.score, 1)
    for name in ("observations", "poses"):  # of agents that have not respawned
        rows = getattr(found, f"next_{name}")[:-1]
        np.testing.assert_array_equal(rows, getattr(found, name)[1:])
    # What an agent saw came before what it did: its own speed, the first field.
    assert found.observations[0, 0, 0] == 0.0
    assert found.observations[1, 0, 0] > 0.0
    lot.reset()
    assert lot.demonstration is None
    assert lot.score == 0.0


def test_the_end_of_the_drivers_episode_is_noted(lot):
    lot.reset()
    assert lot.note == ""
    while not lot.note and lot.seconds < 60.0:  # the time is up before
        lot.step()
    ended = [x for x in ENDINGS if x.replace("_", " ") in lot.note]
    assert dict(lot.tally())[ended[0]] >= 1
    lot.reset()
    assert lot.note == ""


def test_a_saved_drive_is_the_same_when_replayed(lot, tmp_path):
    lot.reset()
    save(lot, tmp_path)  # nobody has driven
    assert not [*tmp_path.iterdir()]
    first = drive(lot)
    save(lot, tmp_path)
    save(lot, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["drive-0.npz", "drive-1.npz"]
    loaded = load_demonstration(tmp_path / "drive-0.npz")
    assert (loaded.config, loaded.seed) == (first.config, first.seed)
    again = drive(replay(loaded))
    for name in STEPS:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(first, name))
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))


def test_a_drive_is_written_as_a_video(lot, tmp_path):
    drive(lot, 2)
    save(lot, tmp_path)
    video = tmp_path / "drive.gif"
    drive_file = str(tmp_path / "drive-0.npz")
    main(PlayConfig(replay=drive_file, video=str(video), camera="topdown"))
    from PIL import Image

    with Image.open(video) as shown:
        assert shown.n_frames == 2 * lot.traces


def test_a_page_has_a_wheel_and_a_pedal_that_drive(tmp_path):
    pytest.importorskip("mjviser")
    config = PlayConfig(num_parked_cars=2, view="web", port=8767, out=str(tmp_path))
    with open_page(config.port) as page:
        _, lot, held = make_wheel(config, page)
        for _ in range(lot.traces):
            lot.step()
        held["steer"].value, held["pedal"].value = 0.5, 1.0
        for _ in range(lot.traces):
            lot.step()
        np.testing.assert_allclose(lot.demonstration.actions[:, 0], [[0, 0], [0.5, 1]])
        for _ in range(2):  # nobody drives before the second
            lot.reset()
        (saved,) = tmp_path.iterdir()
        assert len(load_demonstration(saved)) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--video a.mp4", "give --replay"),
        ("--replay none.npz", "cannot use none.npz"),
        ("--view window", "no display"),
        ("--num-agents 0 --view web", "num_agents must be at least 1"),
        ("--view web --out /dev/null", "cannot use /dev/null: File exists"),
    ],
)
def test_bad_input_is_one_sentence(arguments, message, capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert_refused(capsys, "play", arguments.split(), message)


def test_other_files_are_no_drives(tmp_path):
    path = tmp_path / "x.npz"
    np.savez(path, x=np.zeros(2))
    with pytest.raises(ValueError, match="is not a demonstration"):
        load_demonstration(path)
    path.write_text("hello")
    with pytest.raises(ValueError, match="another kind of file"):
        load_demonstration(path)


def test_a_drive_with_junk_in_its_header_is_a_drive_or_refused(lot, tmp_path):
    drive(lot)
    save(lot, tmp_path)
    path = tmp_path / "drive-0.npz"
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    header = json.loads(str(arrays["header"]))
    for seed in range(200):
        junk = json.dumps(with_junk(header, seed))
        np.savez(path, **arrays | {"header": np.array(junk)})
        with contextlib.suppress(ValueError):
            assert len(load_demonstration(path)) == STEPS_DRIVEN


STEP = 0.2  # s


def hold(keys, controls=None, speed=0.0, steps=1):
    controls = controls or Controls()
    for _ in range(steps):
        controls = from_keys({*keys}, controls, speed, STEP)
    return controls


@pytest.mark.parametrize(
    ("keys", "steer", "pedal"),
    [
        ((), 0, 0),
        (("LEFT",), 1, 0),
        (("D",), -1, 0),
        (("S",), 0, -1),
        (("W", "A"), 1, 1),
        (("LEFT", "RIGHT", "UP", "DOWN"), 0, 0),
    ],
)
def test_keys_steer_and_drive(keys, steer, pedal):
    assert {*keys} <= {*KEYS}
    controls = hold(keys)
    assert np.sign(controls.steer) == steer
    assert controls.pedal == pytest.approx(pedal * KEY_PEDAL)


def test_the_wheel_turns_at_a_rate_and_comes_back():
    turned = hold(["LEFT"])
    assert turned.steer == pytest.approx(STEER_RATE * STEP)
    assert hold(["LEFT"], steps=20).steer == 1.0
    assert hold([], turned).steer == pytest.approx(0.0)
    assert hold([], hold(["RIGHT"], steps=20)).steer == pytest.approx(-0.6)


def test_the_brake_acts_against_the_motion():
    assert hold(["SPACE", "UP"], speed=2.0).pedal == -1.0
    assert hold(["SPACE"], speed=-2.0).pedal == 1.0
    assert hold(["SPACE"]).pedal == stop(0.05) == 0.0


def gamepad(stick=0.0, left=-1.0, right=-1.0):
    return from_gamepad([stick, 0.0, 0.0, 0.0, left, right])


def test_a_gamepad_acts_from_rest_to_its_stops():
    assert gamepad() == Controls(0.0, 0.0)
    assert gamepad(stick=0.09).steer == 0.0  # dead zone
    assert gamepad(stick=-1.0).steer == 1.0
    assert gamepad(stick=1.0).steer == -1.0
    assert gamepad(right=1.0).pedal == 1.0
    assert gamepad(left=1.0).pedal == -1.0
    assert gamepad(left=0.0, right=0.0).pedal == 0.0
    assert 0.0 < gamepad(stick=-0.2).steer < 0.2
    action = Controls(1.5, -3.0).action  # in range
    assert action.dtype == np.float32
    np.testing.assert_array_equal(action, [1.0, -1.0])
    # With dynamic goals: the bay that the driver tracks.
    np.testing.assert_array_equal(pad(np.float32([0.5, -1]), 3), [[0.5, -1, 1]])
