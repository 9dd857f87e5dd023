"""Layers: which packages may import which, and what an import may cost."""

import ast
import graphlib
import json
from pathlib import Path

import pytest
from faults import FAULTS
from helpers.programs import python

ROOT = Path(__file__).parents[1]
LIBRARY = ROOT / "carpark_mj"
FILES = sorted(LIBRARY.rglob("*.py"))

# The layers, lowest first: a package imports lower layers only.
LAYERS = (
    ("extensions",),
    ("compilation", "pretrained", "precision", "config", "files", "reading"),
    ("geometry",),
    ("layouts",),
    ("types", "vehicle"),
    ("obstacles",),
    ("observations", "scene"),
    ("cameras",),
    ("mdp", "physics"),
    ("movers",),
    ("spawning", "identification"),
    ("env",),
    ("tasks",),
    ("registry", "registration", "policy"),
    ("planning",),
    ("evaluation",),
    ("analysis",),
    ("rendering",),
    ("wrappers", "play", "editor"),
    ("cli",),
    ("training",),
    ("sweeps", "benchmarking"),
    ("suite",),
    ("programs",),
    ("__main__",),
)
LAYER = {
    package: number for number, packages in enumerate(LAYERS) for package in packages
}
# No package of the task or below it imports MuJoCo, or the cars that need it.
WITHOUT_MUJOCO = ("precision", "config", "geometry", "layouts", "types", "obstacles")
WITHOUT_MUJOCO += ("observations", "mdp")
AROUND_TASK = {"vehicle", "scene", "physics"}
OTHERS = {"carpark_papers", "carpark_formats"}  # distributions


def loaded_nodes(tree):
    """All nodes but those only type checkers read."""
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            yield node
            yield from loaded_nodes(node)


def imports_of(path):
    """Dotted names of everything a file loads, at any depth."""
    names = []
    for node in loaded_nodes(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def part_of(path):
    """The part of the library a file belongs to: `carpark_mj/<part>…`."""
    if path == LIBRARY / "config" / "env.py":  # made of the settings of all parts
        return "env"
    return path.relative_to(LIBRARY).parts[0].removesuffix(".py")


def packages_imported(path):
    names = [name.split(".") for name in imports_of(path)]
    packages = {name[1] for name in names if name[0] == "carpark_mj" and name[1:]}
    return packages - {part_of(path)}


def sources(packages):
    return [path for path in FILES if part_of(path) in packages]


def test_every_package_has_a_layer_and_the_architecture_shows_it():
    assert {part_of(path) for path in FILES} == {*LAYER, "__init__"}
    page = (ROOT / "docs" / "architecture.md").read_text()
    picture = page.split("```text\n")[1].split("```")[0]
    lines = [line.split("  ")[0].split(", ") for line in picture.splitlines()]
    assert [sorted(packages) for packages in reversed(lines)] == [*map(sorted, LAYERS)]


def test_no_two_test_files_have_the_same_name():
    # Pytest collects only one of them, and not all extras are installed in CI.
    folders = (ROOT / name / "tests" for name in ("", "papers", "formats"))
    names = [path.name for folder in folders for path in folder.rglob("test_*.py")]
    assert len(names) == len({*names})


def test_few_files_stand_at_the_root_of_the_package():
    assert len(list(LIBRARY.glob("*.py"))) <= 16


@pytest.mark.parametrize("package", sorted(LAYER))
def test_imports_point_down(package):
    files = sources({package})
    assert files
    for path in files:
        wrong = {
            other for other in packages_imported(path) if LAYER[other] >= LAYER[package]
        }
        if package == "types":  # what its annotations name is not loaded
            wrong -= {"vehicle"}
        assert wrong == set(), path


@pytest.mark.parametrize("package", WITHOUT_MUJOCO)
def test_task_and_geometry_do_not_import_mujoco(package):
    for path in sources({package}):
        roots = {name.split(".")[0] for name in imports_of(path)}
        assert "mujoco" not in roots, path
        assert package == "types" or not packages_imported(path) & AROUND_TASK, path


def test_the_library_never_imports_the_programs():
    programs = {path.stem for path in (ROOT / "train").iterdir()}
    programs |= {path.stem for path in (ROOT / "eval").glob("*.py")}
    assert {"ppo", "evaluate"} <= programs
    for path in FILES:
        roots = {name.split(".")[0] for name in imports_of(path)}
        assert not roots & (programs | {"train", "eval", "tests"} | OTHERS)


# What a lot steps without.
AROUND = ("cli.flags", "evaluation", "policy", "rendering.stage", "scene", "suite")
AROUND_ENV = {f"carpark_mj.{package}" for package in (*AROUND, "training")}
# What is imported, in this order in one process, and what may not be loaded by then.
HEAVY = {"OpenGL", "glfw", "matplotlib", "flask", "brax", "imageio", "tyro"}
EXTRAS = {"tyro", "tensorboardX", "matplotlib", "imageio_ffmpeg"}
MOST_MODULES = 75  # of the library, of an environment
STAGES = [
    # Before `process` Ctrl-C is Python's own: nothing but the standard library.
    (("", ".cli.process"), HEAVY | {"mujoco", "jax", "gymnasium", "numpy"}),
    ([f".{name}" for name in sorted(WITHOUT_MUJOCO)], HEAVY | {"mujoco"}),
    ((".env",), HEAVY - {"glfw"} | {"mujoco.mjx", "trimesh"} | AROUND_ENV),
    ((".registry",), {"carpark_mj.suite", *OTHERS}),
    ((".policy.networks",), {"mujoco.mjx", "scipy", "trimesh"}),  # Brax alone
    # The settings of a training need no package of an extra; flax has rich.
    ((".training",), EXTRAS | {"carpark_mj.suite", *OTHERS}),
    ((), EXTRAS | OTHERS),  # after the settings were made
    ((".suite",), EXTRAS | OTHERS),
]
CODE = """
import importlib, json, sys
for names in json.loads(sys.argv[1]):
    for name in names:
        importlib.import_module("carpark_mj" + name)
        if name == ".training":
            sys.modules["carpark_mj.env"].ParkingEnv()
    if not names:
        from carpark_mj.training import PRESETS, PPOConfig
        PPOConfig(), PRESETS["gpu"]
    print(*sys.modules)
"""


def test_imports_are_silent_and_load_nothing_heavy():
    stages = json.dumps([[*names] for names, _ in STAGES])
    # MuJoCo itself loads the GL back end that this variable asks for.
    done = python("-W", "error", "-c", CODE, stages, cwd=ROOT, MUJOCO_GL=None)
    assert (done.returncode, done.stderr) == (0, "")
    loaded = [set(line.split()) for line in done.stdout.splitlines()]
    for found, (names, heavy) in zip(loaded, STAGES, strict=True):
        assert not found & heavy, names
    assert "mujoco" in loaded[2]
    assert sum(name.startswith("carpark_mj") for name in loaded[2]) <= MOST_MODULES


def test_no_module_imports_itself_by_way_of_others():
    names = {path.relative_to(ROOT).with_suffix(""): path for path in FILES}
    modules = {
        ".".join(name.parts).removesuffix(".__init__"): path
        for name, path in names.items()
    }
    graph = {}
    for module, path in modules.items():
        pairs = [(name, name.rpartition(".")[0]) for name in imports_of(path)]
        found = {name if name in modules else parent for name, parent in pairs}
        graph[module] = found & {*modules}
    assert len(graph) > 50
    graphlib.TopologicalSorter(graph).prepare()  # its error names the circle


def test_the_suite_needs_no_optional_package():
    """Looking an environment up loads the suite, in a plain installation too."""
    optional = ("shapely", "pyproj", "ezdxf", "ompl", "viser", "onnx", "moviepy")
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({optional}))\n"
        "import carpark_mj.suite.evaluation\n"
        "from carpark_mj.registry import environment\n"
        "print(environment('valet').layout)"
    )
    done = python("-c", code)
    assert done.stdout.split() == ["valet"], done.stderr


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_has_its_place_and_its_tests(name):
    """`tests/faults.py` puts it in; that takes minutes."""
    fault = FAULTS[name]
    assert (ROOT / "carpark_mj" / fault.path).read_text().count(fault.right) == 1
    assert all((ROOT / "tests" / file).exists() for file in fault.tests.split())
