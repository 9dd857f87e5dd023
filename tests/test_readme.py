"""What the README says is what the code declares."""

import re
from pathlib import Path

from carpark_mj.config import REWARDS, EnvConfig
from carpark_mj.layouts import SQUARES
from carpark_mj.observations import markdown_table
from vehicle_suite.table import readme_table

README = (Path(__file__).parents[1] / "README.md").read_text()


def test_the_observation_table_is_the_declared_one():
    pattern = r"<!-- observation table -->\n(.*?)\n<!-- end of observation table -->"
    found = re.search(pattern, README, re.DOTALL)
    expected = markdown_table(EnvConfig())
    assert found, f"paste this between the markers:\n{expected}"
    assert found[1].strip() == expected, f"paste this:\n{expected}"


def test_the_physics_table_is_made_from_the_report():
    pattern = r"<!-- physics table -->\n(.*?)\n<!-- end of physics table -->"
    found = re.search(pattern, README, re.DOTALL)
    report = Path(__file__).parents[1] / "docs" / "physics" / "report.csv"
    expected = readme_table(report)
    assert found, f"paste this between the markers:\n{expected}"
    assert found[1].strip() == expected, f"paste this:\n{expected}"


def test_every_layout_reward_set_and_reward_term_is_named():
    terms = ("park", "crash", "time", "progress", "closeness", "approach")
    for name in (*SQUARES, *REWARDS, *terms, "smoothness", "reverse"):
        assert f"`{name}`" in README, name


def test_the_first_and_the_second_command_are_there():
    assert "python train/ppo.py\n" in README
    block = README.split("<!-- test command -->\n")[1].split("```")[1]
    assert block == 'bash\npip install ".[test]" && pytest\n'


def test_links_lead_to_files():
    root = Path(__file__).parents[1]
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (root / target).exists(), target
