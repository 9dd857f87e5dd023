"""No import circles: every module can be read after those it imports."""

import ast
import graphlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]


def module_name(path: Path, root: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def loaded_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those only type checkers read."""
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            yield node
            yield from loaded_nodes(node)


def import_graph(root: Path) -> dict[str, set[str]]:
    """Modules of the package under `root` that each of them imports, anywhere in it."""
    sources = {
        module_name(path, root): path.read_text()
        for path in (root / "carpark_mj").rglob("*.py")
    }
    graph: dict[str, set[str]] = {}
    for name, source in sources.items():
        found = set()
        for node in loaded_nodes(ast.parse(source)):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{name}: relative import"
                for alias in node.names:
                    part = f"{node.module}.{alias.name}"
                    found.add(part if part in sources else str(node.module))
        graph[name] = found & set(sources)
    return graph


def test_no_module_imports_itself_by_way_of_others():
    graph = import_graph(ROOT)
    assert len(graph) > 50
    graphlib.TopologicalSorter(graph).prepare()  # its error names the circle


def test_the_core_is_imported_without_the_suite_or_extensions():
    code = (
        "import sys, carpark_mj.env; "
        "print(sum(m.startswith('carpark_mj') for m in sys.modules)); "
        "import carpark_mj.registry; "
        "import carpark_mj.training.ppo.presets; "
        "carpark_mj.env.ParkingEnv(); "
        "print(*(m for m in sys.modules if '_mj.suite' in m or '_papers' in m))"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    loaded, *extensions = ended.stdout.split()
    assert int(loaded) <= 90
    assert extensions == []


def test_the_suite_needs_no_optional_package():
    """Looking an environment up loads the suite, in a plain installation too."""
    optional = ("shapely", "pyproj", "ezdxf", "ompl", "viser", "onnx", "moviepy")
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({optional}))\n"
        "import carpark_mj.suite.evaluation\n"
        "from carpark_mj.registry import environment\n"
        "print(environment('valet').num_agents)"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert ended.stdout.split() == ["1"]
