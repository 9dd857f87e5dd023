"""The junction as a JaxMARL environment: dicts by agent, under `jit` and `vmap`."""

# The library may be absent.
# pyright: basic, reportMissingImports=false

from typing import Any

from carpark_mj.wrappers.jaxmarl import JaxMarlAgents
from carpark_mj.wrappers.options import Options
from carpark_papers.cederle.adapters.common import junction_env, observation_box


class JaxMarlJunction(JaxMarlAgents):
    """A junction whose agents have one episode each; see `JaxMarlAgents`."""

    outcomes = ("arrived", "crashed", "off_road", "off_route", "timed_out", "diverged")

    def __init__(self, **options: Any) -> None:
        """Builds the environment from fields of `JunctionConfig` but `respawn`."""
        env = junction_env(**options)
        form: Options = {"discrete": env.config.action == "index"}
        super().__init__(env, observation_box(env), form)
