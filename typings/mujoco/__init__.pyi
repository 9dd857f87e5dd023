"""For Pyright: MuJoCo's bindings are compiled and untyped, so every name is `Any`."""

from typing import Any

def __getattr__(name: str) -> Any: ...
