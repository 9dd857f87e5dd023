"""Metrics of episodes; `docs/metrics.md` defines every metric."""

from carpark_mj.mdp.metrics.episode import episode_metrics, init_stats, update_stats

__all__ = ["episode_metrics", "init_stats", "update_stats"]
