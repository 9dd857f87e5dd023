"""The layout editor: its checks, its server, the command, and the page in Chromium."""

import copy
import http.client
import json
import shutil
import socket
import threading

import jax
import numpy as np
import pytest
from helpers.mutating import with_junk
from helpers.programs import assert_refused

from carpark_mj.editor.server import Draft, EditorServer, find_faults, read_picture
from carpark_mj.layouts import make_layout
from carpark_mj.layouts.files import complete, document_text, read_json

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
LOT = complete(
    {
        "format": "carpark_mj layout 1",
        "bays": [
            {"pose": [x, 6.5, -1.5708], "size": [5, 2.5]} for x in (-2.5, 0.0, 2.5)
        ],
        "walls": [{"pose": [0, 9.5, 0], "size": [20, 0.2], "kind": "kerb"}],
        "spawns": [{"pose": [0, 0, 0], "size": [6, 1]}],
        "extent": [12, 10],
    }
)


def changed(path, value):
    """The lot with another value at a path, as in "bays/1/size"."""
    lot = copy.deepcopy(LOT)
    *way, last = [int(x) if x.isdecimal() else x for x in path.split("/")]
    place = lot
    for step in way:
        place = place[step]
    place[last] = value
    return lot


NARROW, AWAY = changed("bays/1/size", [5, 1.5]), changed("spawns/0/pose", [0, 2.9, 0])
NEAR = changed("bays/2/pose", [0.5, 6.5, -1.5708])
FAULTS = {
    "bays overlap": (NEAR, {"bays/1", "bays/2"}, True),
    "bays meet walls": (changed("walls/0/size", [20, 6]), {"walls/0"}, True),
    "there is no spawn region": (changed("spawns", []), set(), True),
    "bays are smaller than the car": (NARROW, {"bays/1"}, False),
    "cars spawning in spawn regions meet bays": (AWAY, {"spawns/0"}, False),
    "bays[1].size must be positive, not [5, -1]": (
        changed("bays/1/size", [5, -1]),
        {"bays/1"},
        True,
    ),
}


@pytest.mark.parametrize("text", FAULTS)
def test_a_fault_names_its_rows_and_whether_it_is_grave(text):
    lot, rows, grave = FAULTS[text]
    [fault] = find_faults(lot)
    assert (fault["text"], fault["grave"]) == (text, grave)
    assert rows <= {row for place in fault["places"] for row in place}


def test_faults_are_grave_exactly_where_the_file_is_refused(tmp_path):
    path = tmp_path / "lot.json"
    junk = [with_junk(LOT, seed) for seed in range(15)]
    many = changed("bays", [*LOT["bays"] * 30])  # more than the rows that are padded
    for lot in (LOT, many, *junk, *(lot for lot, *_ in FAULTS.values())):
        path.write_text(json.dumps(lot))
        try:
            read_json(path)
            taken = True
        except ValueError:
            taken = False
        faults = find_faults(lot) if isinstance(lot, dict) else [{"grave": True}]
        assert taken != any(fault["grave"] for fault in faults), lot


@pytest.fixture
def server(tmp_path):
    with EditorServer(Draft(tmp_path / "lot.json"), 0) as served:
        thread = threading.Thread(
            target=served.serve_forever, args=(0.05,), daemon=True
        )
        thread.start()
        yield served
        served.shutdown()
        thread.join()


def ask(server, method, path, body=None, **headers):
    """Status of the answer to a request of the page's own, and its JSON or text."""
    connection = http.client.HTTPConnection("localhost", server.server_port, timeout=60)
    own = {"Origin": f"http://localhost:{server.server_port}"}
    connection.request(method, path, body, own | headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    if answer.status == 200:  # no page may frame it
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
    is_json = answer.headers["Content-Type"] == "application/json"
    return answer.status, json.loads(text) if is_json else text


def test_a_lot_is_kept_while_drawn_and_saved_when_it_is_sound(server):
    out, kept = server.draft.out, server.draft.kept
    wrong = FAULTS["bays overlap"][0]
    status, answer = ask(server, "POST", "/check", json.dumps(wrong))
    assert status == 200
    assert [fault["text"] for fault in answer["faults"]] == ["bays overlap"]
    assert Draft(out).document == wrong  # as if the editor had ended
    assert ask(server, "GET", "/lot")[1]["document"] == wrong
    assert ask(server, "POST", "/save", json.dumps(wrong))[0] == 200
    assert not out.exists()
    assert ask(server, "POST", "/save", json.dumps(LOT)) == (200, {"faults": []})
    assert not kept.exists()
    assert make_layout(str(out)).num_bays == 3
    assert Draft(out, out).document == LOT
    ask(server, "POST", "/check", json.dumps(wrong))
    assert kept.exists()
    ask(server, "POST", "/check", json.dumps(LOT))  # undone
    assert not kept.exists()
    least = {name: LOT[name] for name in ("format", "bays", "spawns", "extent")}
    ask(server, "POST", "/save", json.dumps(least))
    assert Draft(out, out).document == LOT | {"walls": []}


def test_a_file_is_saved_as_it_was_opened(tmp_path):
    source, out = tmp_path / "lot.json", tmp_path / "other.json"
    numbers = "[0.0, 6.7, -1.570796]"
    text = document_text(LOT).replace("[0.0, 6.5, -1.5708]", numbers)
    source.write_text(text.replace(', "kind": "standard", "end": "either"', ""))
    draft = Draft(out, source)
    draft.save(draft.document)
    assert numbers in out.read_text()
    for before, after in zip(
        *(jax.tree.leaves(read_json(path)) for path in (source, out)), strict=True
    ):
        np.testing.assert_array_equal(before, after)


REQUESTS = [
    (403, "GET", "/", None, {"Host": "evil.example"}),
    (403, "POST", "/save", "{}", {"Origin": "http://evil.example"}),
    (404, "GET", "/../server.py", None, {}),
    (404, "GET", "/picture", None, {}),
    (409, "POST", "/check", "[1]", {}),
    (409, "POST", "/save", "[" * 100_000, {}),
    (413, "POST", "/check", "", {"Content-Length": "9" * 20}),
    (200, "POST", "/save", "{}", {}),  # a lot with faults
    (200, "GET", "/", None, {}),
    (200, "GET", "/main.js", None, {}),
]


@pytest.mark.parametrize(("status", "method", "path", "body", "headers"), REQUESTS)
def test_nobody_else_is_served_and_nonsense_writes_nothing(
    server, status, method, path, body, headers
):
    assert ask(server, method, path, body, **headers)[0] == status
    assert list(server.draft.out.parent.iterdir()) == []


def test_an_error_of_writing_is_told_to_the_page(server):
    server.draft.kept.mkdir()
    status, answer = ask(server, "POST", "/check", json.dumps(LOT))
    assert (status, answer["error"].count("\n")) == (409, 0)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A lot, a picture of 20 by 10 pixels, and files that are neither."""
    image = pytest.importorskip("PIL.Image")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lot.json").write_text(document_text(LOT))
    (tmp_path / "bad.json").write_text('{"format": "carpark_mj layout 1"}')
    image.new("RGB", (20, 10)).save(tmp_path / "plan.png")
    (tmp_path / "bad.png").write_bytes((tmp_path / "plan.png").read_bytes()[:50])
    return tmp_path


REFUSED = [
    ("", "nothing to edit: give FILE.json, or --out for a new lot"),
    ("bad.json", "bad.json: bays, spawns, extent missing"),
    ("lot.csv", "file must end in .json, not 'lot.csv'"),
    ("--out lot.json", "lot.json exists: edit it by `carpark_mj layouts edit lot"),
    ("--out no/lot.json", "cannot use no/lot.json: No such file or directory"),
    ("lot.json --port {taken}", "cannot serve on port {taken}: Address already in"),
    ("lot.json --width 3", "--background and --width, in metres, belong together"),
    ("lot.json --background plan.png --width -3", "width must lie in [0, 10000] m"),
    ("lot.json --background bad.png --width 3", "cannot read the picture bad.png: "),
    ("lot.json --background lot.json --width 3", "a picture must end in one of .png"),
]


@pytest.mark.parametrize(("arguments", "message"), REFUSED)
def test_the_command_refuses_in_one_sentence(arguments, message, folder, capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        words, said = (text.format(taken=port) for text in (arguments, message))
        assert_refused(capsys, "layouts edit", words.split(), said)
    assert len(list(folder.iterdir())) == 4


def test_a_picture_has_its_size_in_metres(folder):
    assert read_picture(folder / "plan.png", width=60.0).size == (60.0, 30.0)


def test_a_lot_is_drawn_mended_and_saved_in_a_browser(server):
    sync_api = pytest.importorskip("playwright.sync_api", reason="no playwright")
    if CHROMIUM is None:
        pytest.skip("needs Chromium")
    with sync_api.sync_playwright() as browsers:
        browser = browsers.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        complaints, requests = [], []
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda line: complaints.append(line.text))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(f"http://localhost:{server.server_port}/")

        def draw(key, start, end):
            corner = page.locator("#plan").bounding_box()
            scale = page.evaluate("document.querySelector('#plan').getScreenCTM().a")
            x = corner["x"] + corner["width"] / 2
            y = corner["y"] + corner["height"] / 2
            page.keyboard.press(key)
            page.mouse.move(x + scale * start[0], y - scale * start[1])
            page.mouse.down()
            page.mouse.move(x + scale * end[0], y - scale * end[1], steps=3)
            page.mouse.up()

        def told(place, words):
            page.locator(place, has_text=words).wait_for(timeout=60_000)

        told("#faults", "there is no bay")
        draw("2", (-10, 4), (10, 4))  # a row of bays
        draw("4", (-10, 9.5), (10, 9.5))  # a wall
        draw("8", (-6, 1), (6, -1))  # where cars start, from corner to corner
        draw("3", (8, 6), (8, 3))  # a bay too many
        told("#words", "bays overlap")
        page.keyboard.press("Control+s")
        told("#state", "Not saved")
        assert not server.draft.out.exists()
        page.keyboard.press("Control+z")
        told("#faults", "No faults")
        page.keyboard.press("Control+s")
        told("#state", "Saved")
        page.locator("#cars").check()
        assert page.locator(".car").count() == 5  # every other bay, and the start
        for command in page.locator("#next code").all_inner_texts():
            assert str(server.draft.out) in command
        browser.close()
    layout = make_layout(str(server.draft.out))
    middle = [[-8.75 + 2.5 * k, 6.5] for k in range(8)]
    np.testing.assert_allclose(layout.bay_pose[:, :2], middle)
    np.testing.assert_allclose(layout.bay_pose[:, 2], -np.pi / 2, atol=1e-5)
    np.testing.assert_allclose(layout.wall_pose, [[0, 9.5, 0]])
    np.testing.assert_allclose(layout.spawn_size, [[12, 2]])
    np.testing.assert_allclose(layout.spawn_pose, [[0, 0, 0]], atol=1e-6)
    assert complaints == []
    own = f"http://localhost:{server.server_port}/"
    assert all(url.startswith((own, "data:")) for url in requests)
