"""Independent deep Q-learning at the junction."""
