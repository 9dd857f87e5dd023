"""docs/layouts.md names every layout; what docs/own_lot.md shows works."""

import re
from pathlib import Path

from carpark_mj.config import LAYOUTS
from carpark_mj.layouts.files import _SCHEMA, read_json

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "layouts.md").read_text()
GUIDE = (DOCS / "own_lot.md").read_text()


def blocks(language):
    """The blocks of code of the guide in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", GUIDE, re.M | re.S)


def test_the_table_of_layouts_is_that_of_the_code():
    table = PAGE.split("<!-- layouts -->\n")[1].split("<!-- end of layouts -->")[0]
    rows = re.findall(r"^\| `(\w+)` \| `(\w+)` \| (\d+) \| (\w+) \|", table, re.M)
    assert {row[0]: row[1:] for row in rows} == {
        name: (
            type(config).__name__,
            str(config.min_bays),
            "yes" if config.is_random else "no",
        )
        for name, config in LAYOUTS.items()
        if not name.startswith(("tpcap_", "slots"))  # of carpark_papers
    }


def test_the_layout_file_is_valid(tmp_path):
    path = tmp_path / "my_lot.json"
    [text] = blocks("json")
    path.write_text(text)
    assert read_json(path).num_bays == 3


def test_the_schema_of_the_guide_is_that_of_the_reader():
    table = GUIDE.split("<!-- schema -->\n")[1].split("<!-- end of schema -->")[0]
    rows = [row.split("|")[1:3] for row in table.splitlines()[2:]]
    assert {
        name.strip(" `"): re.findall(r"`(\w+)`", fields) for name, fields in rows
    } == {name: list(fields) for name, fields in _SCHEMA.items()}


def test_the_examples_of_the_guide_run():
    families, car = blocks("python")
    names = {}
    exec(families, names)
    configs = [names[name] for name in ("back_in", "deck", "often_deck")]
    assert names["env"].layout_config == configs[2]
    assert configs[2].members[:2] == (configs[0], configs[1])
    exec(car, names)
    assert names["env"].vehicle.mass == 1500.0
