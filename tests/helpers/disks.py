"""Disks with little room, without being root, and terminals that are gone."""

import contextlib
import resource


@contextlib.contextmanager
def largest_file(size):
    """In it no file, of child processes neither, can grow beyond some bytes."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def no_printing(*_, **__):
    """Takes the place of what prints: a terminal that is gone."""
    raise BrokenPipeError
