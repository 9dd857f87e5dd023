"""What `helpers.session` sets up before JAX is imported here too."""

from helpers.session import compact, released_programs

__all__ = ["compact", "released_programs"]
