"""The house: who may import whom, and what an import may cost."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIBRARY = ROOT / "carpark_mj"
FILES = sorted(LIBRARY.rglob("*.py"))

# What the modules of a package may import from `carpark_mj`, besides their own
# package: design, section 3.
BASE = {"geometry", "types", "config", "precision"}
TASK = {
    "actions",
    "broad_phase",
    "lanes",
    "observations",
    "goals",
    "giving_way",
    "spawn",
    "crash_spawn",
    "exploring_spawn",
    "episode",
    "rewards",
    "metrics",
    "tallies",
    "clearance",
    "collision_time",
    "sensors",
    "fit",
    "respawn",
    "dynamic_goals",
    "exploring",
    "goal_rewards",
    "spaces",
}
ALLOWED = {
    "geometry": set(),
    "types": set(),
    "config": set(),
    "precision": set(),
    "vehicle": BASE,
    "layouts": BASE,
    "scene": BASE | {"vehicle", "layouts"},
    "physics": BASE | {"vehicle", "layouts", "scene"},
    "randomization": {"config", "vehicle"},
    "fleet": {"config", "vehicle", "layouts", "fit", "goals", "respawn"},
} | {name: BASE | TASK | {"layouts"} for name in TASK}
ALLOWED["presets"] = {"config"}
ENV = {*ALLOWED, "state", "searching", "starts", "observing", "rewarding", "env"}
for name in ("state", "searching", "starts", "observing", "rewarding", "env"):
    ALLOWED[name] = ENV - {"env", "scene"}
OUTER = {
    "wrappers",
    "policy",
    "rendering",
    "evaluation",
    "catalogue",
    "aggregation",
    "command_line",
}

# No module of the task or below it knows MuJoCo.
WITHOUT_MUJOCO = BASE | TASK | {"layouts"}


def imports_of(path):
    """Dotted names of everything a file imports, at any depth."""
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def part_of(path):
    """The part of the library a file belongs to: `carpark_mj/<part>…`."""
    return path.relative_to(LIBRARY).parts[0].removesuffix(".py")


def sources(parts):
    """Modules of some parts; a part's command line stands on top of everything."""
    modules = [path for path in FILES if path.name != "__main__.py"]
    return [path for path in modules if part_of(path) in parts]


def parts_imported(path):
    names = [name.split(".") for name in imports_of(path)]
    return {name[1] for name in names if name[0] == "carpark_mj"} - {part_of(path)}


def test_every_part_of_the_library_has_a_place_in_the_import_order():
    assert {part_of(path) for path in FILES} <= {*ENV, *OUTER, "__init__"}
    assert sources(TASK)


@pytest.mark.parametrize("part", sorted(ALLOWED))
def test_imports_point_in_one_direction(part):
    files = sources({part})
    assert files
    wrong = {
        str(path.relative_to(ROOT)): sorted(extra)
        for path in files
        if (extra := parts_imported(path) - ALLOWED[part])
    }
    assert wrong == {}


def test_nothing_below_the_environment_imports_what_is_above_it():
    for path in sources(ENV):
        assert not parts_imported(path) & OUTER, path


@pytest.mark.parametrize("part", sorted(WITHOUT_MUJOCO))
def test_task_and_geometry_do_not_import_mujoco(part):
    for path in sources({part}):
        roots = {name.split(".")[0] for name in imports_of(path)}
        assert "mujoco" not in roots, path


def test_the_library_never_imports_the_programs():
    programs = {path.stem for path in (ROOT / "train").iterdir()}
    programs |= {path.stem for path in (ROOT / "eval").glob("*.py")}
    assert {"ppo", "learners", "evaluate"} <= programs
    for path in FILES:
        roots = {name.split(".")[0] for name in imports_of(path)}
        assert not roots & (programs | {"train", "eval", "tests"}), path


def run(code):
    """Runs code in a fresh interpreter; what it prints on both channels."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=ROOT,
        # MuJoCo itself loads the GL back end that this variable asks for.
        env={k: v for k, v in os.environ.items() if k != "MUJOCO_GL"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


def loaded_by(module):
    """Top-level modules in `sys.modules` after an import."""
    code = f"import sys\nimport {module}\nprint(*sorted(sys.modules))"
    return set(run(code)[0].split())


def test_importing_the_package_is_silent():
    assert run("import carpark_mj") == ("", "")


def test_importing_the_package_loads_nothing_heavy():
    heavy = {"OpenGL", "glfw", "matplotlib", "flask", "brax", "mujoco", "jax"}
    assert not loaded_by("carpark_mj") & heavy


def test_importing_the_environment_loads_no_plots_servers_or_trainers():
    loaded = loaded_by("carpark_mj.env")
    assert "mujoco" in loaded
    heavy = {"OpenGL", "matplotlib", "flask", "brax", "imageio", "tyro"}
    assert not loaded & heavy
    assert not {name for name in loaded if name.startswith("carpark_mj.rendering")}


def test_importing_the_task_does_not_load_mujoco():
    modules = "\n".join(f"import carpark_mj.{name}" for name in sorted(WITHOUT_MUJOCO))
    printed, _ = run(f"import sys\n{modules}\nprint('mujoco' in sys.modules)")
    assert printed.split() == ["False"]
