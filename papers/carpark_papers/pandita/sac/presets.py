"""Settings of SAC by name."""

from carpark_papers.pandita.sac.config import SACConfig

SAC_PRESETS: dict[str, SACConfig] = {
    "slots": SACConfig(),
    # The budgets of Pandita 2022 with smaller networks and batches than his, but twice
    # as many gradient steps, and falling learning rates: at a constant rate the
    # deterministic policy parks or crashes from one update to the next.
    "study": SACConfig(
        preset="study",
        phases=("slots:15000",),
        num_cars=4,
        gradient_steps=8,
        learning_rate_end=1e-4,
    ),
    # His hyperparameters; highway-env's example has the same. Of those that he leaves
    # at the defaults of Stable-Baselines3: 100 random steps, one gradient step.
    "pandita": SACConfig(
        preset="pandita",
        phases=("slots:15000",),
        num_cars=1,
        gradient_steps=1,
        batch_size=1024,
        buffer_size=1_000_000,
        random_steps=100,
        learning_rate_end=1e-3,
        tau=0.05,
        hidden=(512, 512, 512),
    ),
}

SAC_SUMMARIES = {
    "slots": "vertical slots, many cars at once",
    "study": "budgets of Pandita 2022, small networks",
    "pandita": "settings of Pandita 2022, hours on a CPU",
}
