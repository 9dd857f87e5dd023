"""The task: actions, goals, episodes, rewards and metrics of the MDP."""
