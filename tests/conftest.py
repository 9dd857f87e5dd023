"""What `helpers.session` sets up before JAX is imported, for the tests of the core."""

from helpers.session import compact, pytest_collection_modifyitems, released_programs

__all__ = ["compact", "pytest_collection_modifyitems", "released_programs"]
