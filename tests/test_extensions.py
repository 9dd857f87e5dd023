"""Registries find what packages outside the core register."""

import sys
import textwrap
from types import SimpleNamespace

import pytest

from carpark_mj import extensions
from carpark_mj.extensions import VARIABLE, Registry, load_extensions


@pytest.fixture
def extension(tmp_path, monkeypatch):
    """Writes a module that `VARIABLE` names; returns what writes it.

    It can import `cars`, a registry, from `trial_registry`.
    """
    monkeypatch.setattr(extensions, "_loaded", set(extensions._loaded))
    monkeypatch.setattr(extensions, "_broken", dict(extensions._broken))
    monkeypatch.syspath_prepend(str(tmp_path))
    sys.modules["trial_registry"] = SimpleNamespace(cars=Registry("car"))

    def write(name, text):
        (tmp_path / f"{name}.py").write_text(textwrap.dedent(text))
        monkeypatch.setenv(VARIABLE, name)

    yield write
    for name in [m for m in sys.modules if m.startswith("trial_")]:
        del sys.modules[name]


def test_two_parts_of_one_name_are_refused():
    registry = Registry("car")
    mini = registry.register("mini", [1])
    assert registry.register("mini", mini) is mini  # a module reloaded
    with pytest.raises(ValueError, match="mini"):
        registry.register("mini", [1])
    for name in (["mini"], None, 1, {"a": 1}):
        assert name not in registry
        with pytest.raises(ValueError, match=r"unknown car .*choose from .'mini'"):
            registry[name]


def test_an_unknown_name_imports_the_extensions(extension):
    registry = sys.modules["trial_registry"].cars
    extension(
        "trial_package",
        """
        from trial_registry import cars
        cars.register("mini", 3.05)
        """,
    )
    registry.register("van", 4.9)
    assert registry["van"] == 4.9
    assert "trial_package" not in sys.modules  # not needed yet
    assert registry["mini"] == 3.05
    assert list(registry) == ["mini", "van"]
    with pytest.raises(ValueError, match=r"bus.*mini.*van"):
        registry["bus"]


def test_an_extension_that_does_not_import_is_named(extension):
    extension(
        "trial_broken",
        """
        from trial_registry import cars
        cars.register("mini", [])
        raise RuntimeError('no such file')
        """,
    )
    for _ in range(2):  # and not that "mini" is there already
        with pytest.raises(ValueError, match=r"trial_broken.*no such file"):
            load_extensions()


def test_a_lost_extension_is_told_from_a_missing_module(extension, monkeypatch):
    extension("trial_needy", "import nowhere_to_be_found")
    with pytest.raises(ValueError, match="nowhere_to_be_found") as caught:
        load_extensions()
    assert "PYTHONPATH" not in str(caught.value)
    monkeypatch.setenv(VARIABLE, "trial_lost")
    with pytest.raises(ValueError, match=r"trial_lost.*PYTHONPATH"):
        load_extensions()


def test_installed_extensions_are_looked_for_once(monkeypatch):
    calls = []
    monkeypatch.setattr(
        extensions.importlib.metadata,
        "entry_points",
        lambda group: calls.append(group) or (),
    )
    extensions._extensions.cache_clear()
    for _ in range(3):
        assert len(Registry("car")) == 0
    assert calls == [extensions.GROUP]
    extensions._extensions.cache_clear()
