"""Commands with a page in the browser, which opens before the work and is filled later.

Until then the page shows what the command does, and for how long. Only viser is
imported before it is open.
"""

import contextlib
import threading
from collections.abc import Generator
from typing import Any

from carpark_mj.cli.clock import CLOCK, PERIOD
from carpark_mj.cli.settings.driving import PlayConfig, SceneConfig
from carpark_mj.extensions import Entry, require_packages
from carpark_mj.rendering.local_pages import HOST


@contextlib.contextmanager
def open_page(port: int, wanted: bool = True) -> Generator[Any]:
    """Serves an empty page with a clock; gives viser's server, None if not `wanted`."""
    if not wanted:
        yield None
        return
    require_packages("mjviser")
    from carpark_mj.rendering.local_server import LocalServer

    server = LocalServer(HOST, port, "carpark_mj")
    print(f"open http://{HOST}:{server.get_port()} (Ctrl-C ends)", flush=True)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    said, closed = server.gui.add_markdown(""), threading.Event()

    def follow() -> None:
        while not closed.wait(PERIOD):
            if said.content != CLOCK.line:
                said.content = CLOCK.line

    threading.Thread(target=follow, daemon=True).start()
    try:
        yield server
    finally:
        closed.set()
        server.stop()


def scene(config: SceneConfig) -> None:
    """`carpark_mj scene`."""
    with open_page(config.port, config.view == "web") as page:
        Entry("carpark_mj.cli.scene:main").load()(config, page)


def play(config: PlayConfig) -> None:
    """`carpark_mj play`."""
    on_page = config.shown_in == "web" and not config.video
    with open_page(config.port, on_page) as page:
        Entry("carpark_mj.cli.play:main").load()(config, page)
