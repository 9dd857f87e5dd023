"""SAC with hindsight replay in phases, through sbx, Stable-Baselines3's JAX sibling."""
