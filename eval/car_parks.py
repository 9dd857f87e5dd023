"""Evaluates a policy in random parts of the real car parks; writes `car_parks.csv`.

python eval/car_parks.py anywhere
python eval/car_parks.py anywhere --parts 10 --num-agents 4 --episodes 500

Every part has equally many lots with each number of agents, and a route to every bay.
Intervals hold for parts drawn at random: lots of one part count as one cluster.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("car_parks", "car_parks:main")

import dataclasses
import itertools
from pathlib import Path
from typing import Annotated, Any

import tyro

from carpark_mj import ParkingEnv
from carpark_mj.cli.driver import adapt, find_driver
from carpark_mj.config.checks import CheckedConfig, Count, Positive
from carpark_mj.evaluation.aggregation import summarize
from carpark_mj.evaluation.evaluator import evaluate
from carpark_mj.evaluation.report import print_groups
from carpark_mj.files import require_writable, write_csv
from carpark_mj.layouts import MixtureConfig, member_shares
from carpark_mj.layouts.car_park import CAR_PARKS, random_parts
from shell import command


@dataclasses.dataclass(frozen=True)
class CarParksConfig(CheckedConfig):
    """Settings of `python eval/car_parks.py`.

    Attributes:
        policy: a pretrained policy or run folder.
        parts: number of parts of each car park.
        size: of a part in x and y [m].
        num_agents: the most agents in a lot; there are lots with each number from 1.
        episodes: of both car parks, rounded up to an equal number for every agent.
        vehicle: preset or file of all cars.
        seed: of parts and episodes.
        out: folder of the file.
    """

    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    parts: Count = 30
    size: tuple[Positive, Positive] = (60.0, 45.0)
    num_agents: int = 8
    episodes: int = 4096
    vehicle: str = "compact"
    seed: int = 0
    out: str = "runs/car_parks"


def run(config: CarParksConfig) -> None:
    """Evaluates, writes the episodes and prints a table for each car park."""
    path = Path(config.out) / "car_parks.csv"
    require_writable(path, new_folders=True)  # refused before the work
    parts = {
        name: random_parts(name, config.size, config.parts, config.seed)
        for name in CAR_PARKS
    }
    driver = find_driver(config.policy)
    lots = MixtureConfig(members=tuple(itertools.chain(*parts.values())))
    changes: Any = {"layout": lots, "vehicle": config.vehicle, "min_agents": 1}
    env = ParkingEnv(adapt(driver.env, num_agents=config.num_agents, **changes))
    result = evaluate(env, driver.policy(env), config.episodes, config.seed)
    # The parts are samples of a car park, as lots are of a family.
    owners = [name for name, found in parts.items() for _ in found]
    names = member_shares(lots)
    part = {
        name: {"family": owner, "lot": k}
        for k, (name, owner) in enumerate(zip(names, owners, strict=True))
    }
    rows = [row | part[row["family"]] for row in result.episodes]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_csv(path, rows)
    for name in parts:
        print_groups(f"number of agents in {name}", by_agents(rows, name))
    print(f"wrote {path}")


def by_agents(rows: list[dict[str, Any]], name: str) -> dict[str, Any]:
    """Summaries of a car park by the number of agents present, and of all.

    The `lot` of an episode is the number of its part.
    """
    groups: dict[int, list[dict[str, Any]]] = {}
    own = [row for row in rows if row["family"] == name]
    for row in own:
        groups.setdefault(int(row["agents_present"]), []).append(row)
    found = {str(count): summarize(groups[count]) for count in sorted(groups)}
    # A part is one cluster for all numbers of agents.
    return {**found, "all": summarize([row | {"agents_present": 0} for row in own])}


main = command(CarParksConfig, run, __doc__, fused=True)
