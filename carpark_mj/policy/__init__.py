"""Policies: networks, checkpoints and run folders."""
