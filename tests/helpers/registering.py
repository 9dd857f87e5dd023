"""Registries that are as before after a test."""

from carpark_mj.extensions import load_extensions


def restore_after(monkeypatch, *registries):
    """Forgets at the test's end what is registered from now on."""
    load_extensions()  # what they register is to stay
    for registry in registries:
        list(registry)  # the core's own parts, too
        monkeypatch.setattr(registry, "_parts", dict(registry._parts))
