"""Sweeps: every combination of some settings, trained as jobs through submitit."""
