"""Obstacles: all that agents can hit, see and keep away from."""
