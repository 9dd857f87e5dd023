"""Terminals that are gone."""


def no_printing(*_, **__):
    """Takes the place of what prints."""
    raise BrokenPipeError
