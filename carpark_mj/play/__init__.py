"""Driving by hand: controls, a lot to drive in, and recordings."""
