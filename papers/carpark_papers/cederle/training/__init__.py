"""Shared parts of the junction's trainers."""
