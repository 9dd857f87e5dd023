"""Implementation of the commands; the scripts only call it."""
