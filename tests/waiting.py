"""Measures the waiting time of each command: first output, longest silence, total.

    python tests/waiting.py                 # all commands, with empty caches and again
    python tests/waiting.py train render

Each runs on a terminal in a new folder. A command with a page ends when the page shows
its picture.
"""

import contextlib
import math
import os
import pty
import select
import signal
import sys
import tempfile
import time
from pathlib import Path

# A cheap and typical use of each command, in this order: some need files of others.
USES = {
    "vehicles": "compact --save car.json",
    "layouts": "lot --check 1 --plot lot.png --save lot.json",
    "layouts edit": "lot.json --port 8801",
    "layouts import": "map.osm --out map.json",
    "scene": "--policy anywhere --view web --port 8802",
    "play": "--view web --port 8803 --out drives",
    "evaluate": "square",
    "render": "square --out square.mp4 --seconds 10",
    "train": "--name {when} --num-steps 600000 --eval-episodes 64 --video-seconds 2",
    "export": "runs/cold --out policy.npz",
    "analysis": "runs/cold",
    "sweep": "--base cpu --name {when}-sweep --set num_lots=8,16 num_steps=60000",
    "suite": "anywhere --levels tpcap --cases 4",
    "identify": "log.csv --vehicle compact",
    "benchmark": "--what env --batches 64 --repeats 1",
    "study": "",
}
PAGES = ("scene", "play", "layouts edit")
MAP = """<osm version="0.6"><node id="1" lat="48.0" lon="11.0"/>
<node id="2" lat="48.00001" lon="11.0005"/><way id="1"><nd ref="1"/><nd ref="2"/>
<tag k="highway" v="service"/></way>
<node id="3" lat="48.00010" lon="11.0001"/><node id="4" lat="48.00010" lon="11.0004"/>
<node id="5" lat="48.00006" lon="11.0004"/><node id="6" lat="48.00006" lon="11.0001"/>
<way id="2"><nd ref="3"/><nd ref="4"/><nd ref="5"/><nd ref="6"/><nd ref="3"/>
<tag k="amenity" v="parking"/><tag k="capacity" v="8"/></way></osm>"""
QUIET = 2.0  # s without output after which a page is ready
LIMIT = 600.0  # s


def wait_for(command, folder, cache, is_page):
    """Seconds to the first output, of the longest silence and in all; exit code."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(folder)
        os.environ.update(XDG_CACHE_HOME=str(cache), TERM="xterm")
        os.execvp(command[0], command)
    started = last = time.monotonic()
    first, silence, opened, ready = 0.0, 0.0, False, 0.0
    while True:
        readable, _, _ = select.select([terminal], [], [], 0.1)
        now = time.monotonic()
        if readable:
            said = b""
            with contextlib.suppress(OSError):  # its end, on Linux
                said = os.read(terminal, 65536)
            if not said:
                break
            first = first or now - started
            silence = max(silence, now - last)
            last, opened = now, opened or b"open http" in said
        elif is_page and opened and not ready and now - last > QUIET:
            ready = last - started
            os.kill(pid, signal.SIGINT)
        if ready:  # what follows is its end
            last = now
        if now - started > LIMIT:
            os.kill(pid, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return first, silence, ready or time.monotonic() - started, code


def write_inputs(folder):
    """Writes a small map and the log of a car that swings to and fro at up to 2 m/s."""
    (folder / "map.osm").write_text(MAP)
    rows, speed = ["time,steering,pedal,speed,yaw_rate"], 0.0
    for k in range(300):
        steering, pedal = 0.3 * math.sin(0.1 * k), 0.5 * ((k // 20) % 2)
        speed += 0.1 * (2.0 * pedal - 0.3 * speed)
        rate = speed * math.tan(steering) / 2.637
        rows.append(f"{0.1 * k:.1f},{steering:.4f},{pedal},{speed:.4f},{rate:.4f}")
    (folder / "log.csv").write_text("\n".join(rows))


def main(names):
    """Prints a row for each command and state of its cache."""
    print("command, cache, first [s], silence [s], total [s], exit code")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_inputs(folder)
        for name in names or USES:
            for when in ("cold", "again"):
                words = f"{name} {USES[name].format(when=when)}".split()
                program = [sys.executable, "-m", "carpark_mj", *words]
                cache = folder / name.replace(" ", "-")
                *seconds, code = wait_for(program, folder, cache, name in PAGES)
                times = ", ".join(f"{x:.1f}" for x in seconds)
                print(f"{' '.join(words)}, {when}, {times}, {code}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
