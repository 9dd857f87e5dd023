"""Settings of the commands, read without JAX."""

import dataclasses
from typing import Annotated

import tyro

from carpark_mj.cli.settings.driving import DriveSettings, ExportConfig
from carpark_mj.cli.settings.lots import Crop
from carpark_mj.config.checks import Seed, require_unset
from carpark_mj.files import require_suffix
from carpark_mj.rendering.local_pages import Port

COUNTS = ("others", "parked", "walls", "discs", "people", "movers", "lanes")
Repeated = Annotated[tuple[str, ...], tyro.conf.UseAppendAction]


@dataclasses.dataclass(frozen=True)
class ImportConfig:
    """Makes a layout file of a map of a car park.

    carpark_mj layouts import car_park.osm --out lot.json
    carpark_mj layouts import car_park.geojson --out part.json --crop -20 -10 20 10
    carpark_mj layouts import plan.dxf --out lot.json --unit mm --layer stall=STELLPLATZ

    Attributes:
        map: file to read: Lanelet2 or OpenStreetMap (`.osm`, `.xml`), CommonRoad
            (`.xml`), GeoJSON (`.geojson`, `.json`), a drawing (`.dxf`), or a case of
            ParkBench (`.json`).
        out: layout file to write.
        crop: x and y of two opposite corners [m] of the part to take, in the frame of
            the whole lot.
        level: level of a multi-storey car park, as named in the map; default: the one
            with most spots.
        crs: coordinate reference system of a GeoJSON file that does not name its own,
            such as EPSG:25832.
        layer: of a drawing, WORD=TEXT: the layers whose names contain the text hold
            stalls, aisles, walls, kerbs, columns, drivable ground or starts; may be
            repeated.
        unit: of a drawing without one, or with a wrong one: mm, cm, m, in or ft.
    """

    map: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    out: str
    crop: Crop | None = None
    level: str | None = None
    crs: str | None = None
    layer: Annotated[Repeated, tyro.conf.arg(metavar="WORD=TEXT")] = ()
    unit: str = ""

    def __post_init__(self) -> None:
        require_suffix("out", self.out, ".json")


@dataclasses.dataclass(frozen=True)
class ScenarioImportConfig:
    """Makes a scenario file of another program's.

    carpark_mj scenario import case.xosc --lot lot.json --out case.yaml
    carpark_mj scenario import problem.xml --out problem.yaml
    carpark_mj scenario import rear_in/1712150592.json --out case.yaml

    Attributes:
        file: OpenSCENARIO XML (`.xosc`), CommonRoad (`.xml`), or a case of ParkBench
            (`.json`).
        out: scenario file to write. The lot of CommonRoad and ParkBench is written
            beside it, NAME.lot.json.
        lot: name or file of the lot of an OpenSCENARIO file.
        goal: number of the bay to park in, in the place of the file's goal.
        vehicle: preset or data sheet of the car.
    """

    file: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    out: str
    lot: str = ""
    goal: int | None = None
    vehicle: str = "compact"

    def __post_init__(self) -> None:
        require_suffix("file", self.file, ".xosc", ".xml", ".json")
        require_suffix("out", self.out, ".yaml", ".yml")
        if bool(self.lot) != self.file.endswith(".xosc"):
            raise ValueError("--lot belongs to an OpenSCENARIO file, which has no lot")


@dataclasses.dataclass(frozen=True)
class ScenarioExportConfig:
    """Writes a scenario as OpenSCENARIO or CommonRoad, or drives as its solutions.

    carpark_mj scenario export child.yaml --out child.xosc
    carpark_mj scenario export child.yaml --out child.xml
    carpark_mj scenario export a.yaml --run runs/a --problem problem.xml --out a.xml

    Attributes:
        file: the scenario, .yaml or .json.
        out: OpenSCENARIO XML (`.xosc`), with its map NAME.xodr beside it, or CommonRoad
            (`.xml`); with `run`, solutions NAME.POLICY.CASE.xml.
        run: folder of a run of this scenario, whose worst drives become solutions.
        problem: the CommonRoad file that the scenario was imported from.
    """

    file: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    out: str
    run: str = ""
    problem: str = ""

    def __post_init__(self) -> None:
        require_suffix("out", self.out, ".xml", *[".xosc"] * (not self.run))
        if bool(self.run) != bool(self.problem):
            raise ValueError("--run and --problem belong together")


@dataclasses.dataclass(frozen=True)
class ServeConfig(DriveSettings):
    """Serves a lot on a local socket: JSON lines step it from outside.

    carpark_mj serve zero --layout my_lot.json --vehicle my_car.yaml --num-agents 1
    carpark_mj serve valet --port 9000

    The program at the other end drives. `run` names an environment's policy, whose
    observations the answers have. The documentation describes requests and answers.

    Attributes:
        run: pretrained policy, run folder or checkpoint file, whose environment is
            served, or `zero`: the default one.
        port: of this machine; other machines cannot connect.
    """

    port: Port = 8790


@dataclasses.dataclass(frozen=True)
class OnnxConfig(ExportConfig):
    """Exports a policy as an ONNX model, or as a checkpoint without training state.

    carpark_mj export runs/cpu-0                      # runs/cpu-0/policy.onnx
    carpark_mj export runs/cpu-0 --from-state         # runs/cpu-0/car.onnx, for a car
    carpark_mj export runs/cpu-0 --out policy.npz     # as the pretrained policies are

    An ONNX model has an input for every observation field, with the normalisation
    inside. With --from-state the observation is inside too; inputs are poses of the
    car, the others and the walls. A model is written only if onnxruntime computes the
    policy's actions with it.

    Attributes:
        out: file to write: .onnx, or .npz for a checkpoint of the policy alone;
            default `policy.onnx` (`car.onnx` with --from-state) in the run folder, or
            in `runs/NAME` of a pretrained policy.
        seed: seed of the observations that the model is checked on.
        from_state: the inputs are poses of the car and its surroundings, and the model
            computes the observation.
        others: number of rows for other driving cars; default and least: as many as the
            environment has.
        parked: number of rows for parked cars, likewise.
        walls: number of rows for walls and other boxes, likewise.
        discs: number of rows for pillars and other discs, likewise.
        people: number of rows for people, likewise.
        movers: number of rows for carts, drivers and other movers, likewise.
        lanes: number of rows for lanes, likewise.
    """

    seed: Seed = 0
    from_state: bool = False
    others: int | None = None
    parked: int | None = None
    walls: int | None = None
    discs: int | None = None
    people: int | None = None
    movers: int | None = None
    lanes: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require_suffix("out", self.out, ".onnx", ".npz")
        if self.out.endswith(".npz"):
            require_unset(self, "on a checkpoint", "seed", "from_state")
        if not self.from_state:
            require_unset(self, "without --from-state", *COUNTS)
