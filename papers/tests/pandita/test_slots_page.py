"""The page of Slots-v0: tables of the code, a snippet that runs."""

import subprocess
import sys

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env
from helpers import environment_pages as pages

from carpark_papers.pandita.slots_env import SLOTS_OPTIONS, SlotsEnv
from carpark_papers.pandita.task import PANDITA

NAME = "carpark_mj/Slots-v0"
TEXT = pages.read("slots")
DEFAULTS = {
    "config": "pandita",
    "layout": PANDITA.layout,
    "parked_cars": PANDITA.num_parked_cars,
}


@pytest.mark.parametrize(
    ("marker", "expected"),
    [
        ("summary", pages.summary),
        ("actions", pages.actions),
        ("observation", pages.observation),
        ("rewards", pages.pose),
    ],
)
def test_a_table_of_slots_is_the_generated_one(marker, expected):
    pages.assert_generated(NAME, TEXT, marker, expected)


def test_the_page_of_slots_lists_all_arguments():
    listed = {option: repr(DEFAULTS.get(option)) for option in SLOTS_OPTIONS}
    pages.assert_arguments(TEXT, SlotsEnv, listed)


def test_gymnasium_finds_no_fault_in_slots():
    check_env(gymnasium.make(NAME).unwrapped, skip_render_check=True)


def test_the_example_of_slots_runs():
    pages.run_example(TEXT)


@pytest.mark.parametrize(
    "order", ["carpark_papers, gymnasium", "gymnasium, carpark_papers"]
)
def test_the_id_is_registered_whichever_is_imported_first(order):
    code = f"import {order}; assert gymnasium.spec({NAME!r}).vector_entry_point"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
