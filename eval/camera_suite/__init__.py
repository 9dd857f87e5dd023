"""Cameras against MuJoCo's renderer: pictures of the same state, and speed."""
