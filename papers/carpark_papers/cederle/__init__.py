"""Cederle 2023: automated cars that cross a junction."""
