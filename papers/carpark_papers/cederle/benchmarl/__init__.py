"""Algorithms of BenchMARL at the junction."""
