"""docs/layouts.md names every layout as it is, and its example runs."""

import re
from pathlib import Path

from carpark_mj.config import LAYOUTS

PAGE = (Path(__file__).parents[2] / "docs" / "layouts.md").read_text()


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
        if not name.startswith("tpcap_")
    }


def test_the_example_of_the_page_runs():
    [snippet] = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
    names = {}
    exec(snippet, names)
    configs = [names[name] for name in ("back_in", "deck", "often_deck")]
    assert names["env"].layout_config == configs[2]
    assert configs[2].members[:2] == (configs[0], configs[1])
