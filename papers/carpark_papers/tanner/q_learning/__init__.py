"""Tabular Q-learning: settings, learner, training loop."""
