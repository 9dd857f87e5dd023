"""PPO: settings, learner, training loop."""
