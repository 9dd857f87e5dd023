"""The loop of all trainers where there is no terminal."""

import sys

from rich import jupyter
from rich.console import Console

from carpark_mj.training import loop as loops
from carpark_mj.training.run_folder import RunConfig


def test_a_line_that_a_notebook_s_callback_began_stops_no_training(monkeypatch):
    shown = []

    def display(segments, text):
        """As ipykernel: whatever was printed before comes first."""
        sys.stdout.flush()
        shown.append(text)

    monkeypatch.setattr(jupyter, "display", display)
    console = Console(force_jupyter=True)
    monkeypatch.setattr(loops, "get_console", lambda: console)
    monkeypatch.setattr(loops, "LINE_SECONDS", -1.0)
    loop = loops.Loop("PPO", RunConfig())
    with loop.over(2):
        print("half a line", end="")
        loop.show(1, "parked 50 %")
    assert any("parked 50 %" in text for text in shown)
