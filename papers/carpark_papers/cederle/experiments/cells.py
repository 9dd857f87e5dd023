"""Tables 6.1 to 6.4 of Cederle 2023, cell by cell, and further trainings."""

import dataclasses
from typing import get_args

from carpark_papers.cederle.junction.config import CarModel
from carpark_papers.cederle.training.config import Algorithm, ScenarioName

SCENARIOS: dict[str, ScenarioName] = dict(
    zip(("6.1", "6.2", "6.3", "6.4"), get_args(ScenarioName), strict=True)
)
DQN: tuple[Algorithm, ...] = ("idqn", "double", "dueling", "double-dueling")
CENTRAL: tuple[Algorithm, ...] = ("maddpg", "vdn", "qmix")
BESIDE: tuple[Algorithm, ...] = ("ippo", "mappo")


@dataclasses.dataclass(frozen=True)
class Published:
    """The published result of a single run.

    Attributes:
        solved: whether an evaluation reached the scenario's threshold.
        converged_at: "speed" [control steps]; None = did not converge to a value that
            solves.
    """

    solved: bool
    converged_at: int | None

    @property
    def converged(self) -> bool:
        """Whether it converged to a value that solves."""
        return self.converged_at is not None


@dataclasses.dataclass(frozen=True)
class Cell:
    """An algorithm in a scenario.

    Attributes:
        table: number in the thesis.
        algorithm: which.
        cars: `path` or `mjx`.
        published: None = not in the thesis.
    """

    table: str
    algorithm: Algorithm
    cars: CarModel = "path"
    published: Published | None = None

    @property
    def scenario(self) -> ScenarioName:
        """Of the table."""
        return SCENARIOS[self.table]

    @property
    def name(self) -> str:
        """The algorithm, and the cars unless they are `path`."""
        return self.algorithm + ("" if self.cars == "path" else f"-{self.cars}")


# Tables 6.1, 6.2, 6.3, 6.4: thousand steps to converge; "solved" without convergence.
_NEITHER, _SOLVED = "neither", "solved"
_TABLES: dict[Algorithm, tuple[int | str, ...]] = {
    "idqn": (100, 160, 100, 210),
    "double": (110, 170, 100, 200),
    "dueling": (100, 140, 80, 200),
    "double-dueling": (90, 140, 90, 150),
    "maddpg": (_SOLVED, _SOLVED, _NEITHER, _NEITHER),
    "vdn": (180, _SOLVED, _NEITHER, _NEITHER),
    "qmix": (_SOLVED, _SOLVED, _NEITHER, _NEITHER),
}


def _published(entry: int | str) -> Published:
    if isinstance(entry, str):
        return Published(entry == _SOLVED, None)
    return Published(True, 1000 * entry)


CELLS = tuple(
    cell
    for k, table in enumerate(SCENARIOS)
    for cell in (
        *(
            Cell(table, algorithm, published=_published(entries[k]))
            for algorithm, entries in _TABLES.items()
        ),
        *(Cell(table, name, cars) for cars in ("path", "mjx") for name in BESIDE),
    )
)


def cells_of(table: str) -> tuple[Cell, ...]:
    """The cells of a table.

    Raises:
        ValueError: unknown table.
    """
    if table not in SCENARIOS:
        raise ValueError(f"unknown table {table!r}; choose from {', '.join(SCENARIOS)}")
    return tuple(cell for cell in CELLS if cell.table == table)
