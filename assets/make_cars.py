"""Writes the meshes of the vehicle presets as Wavefront files, `assets/cars/NAME.obj`.

python assets/make_cars.py

The meshes are `carpark_mj.scene.car_mesh`'s, which scenes build by themselves for any
vehicle; the files are for other programs and for looking at.
"""

import argparse
from pathlib import Path

import numpy as np
import trimesh

from carpark_mj.scene.car_mesh import DECIMALS, car_meshes, standing_wheels
from carpark_mj.vehicle import PRESETS, VehicleParameters

FOLDER = Path(__file__).parent / "cars"
# Parts in the frame of the car; wheels stand where they belong.
PARTS = (
    "body",
    "cage",
    "glass",
    "headlights",
    "tail_lights",
    "trim",
    "tyres",
    "rims",
)


def obj_text(name: str, params: VehicleParameters) -> str:
    """A car as the text of a Wavefront file: an object per part, metres, z up."""
    meshes = car_meshes(params) | standing_wheels(params)
    lines = [f"# {name}: x forward, y left, z up, rear axle at the origin [m]"]
    first = 1
    for part in PARTS:
        lines += [f"o {part}", *_mesh_lines(meshes[part], first)]
        first += len(meshes[part].vertices)
    return "\n".join(lines) + "\n"


def _mesh_lines(mesh: trimesh.Trimesh, first: int) -> list[str]:
    # Moving a part to its place leaves noise below the last decimal.
    vertices = np.round(mesh.vertices, DECIMALS) + 0.0
    return [
        *(
            f"v {x:.{DECIMALS}f} {y:.{DECIMALS}f} {z:.{DECIMALS}f}"
            for x, y, z in vertices
        ),
        *(f"f {a} {b} {c}" for a, b, c in np.asarray(mesh.faces) + first),
    ]


def main(folder: Path = FOLDER) -> list[Path]:
    """Writes all files; returns them."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, params in PRESETS.items():
        path = folder / f"{name}.obj"
        path.write_text(obj_text(name, params), newline="\n")
        written.append(path)
    return written


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder to write to")
    for made in main(parser.parse_args().out):
        print(f"wrote {made}")
