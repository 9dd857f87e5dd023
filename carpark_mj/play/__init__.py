"""Driving by hand: controls, a lot to drive in, and what is recorded of it."""
