"""How long a training takes, in words."""

from carpark_mj.training.ppo.config import PPOConfig

MEASURED_SECONDS = 10.0  # of updates before their rate is told
# 1024 episodes and 20 s on two cores at half of their speed, compiling included [min].
EVALUATION_MINUTES = 0.6
VIDEO_MINUTES = 1.4


def announcement(config: PPOConfig, update: int, seconds: float) -> str:
    """What a run is going to do, said before it.

    Args:
        config: of the run.
        update: updates made before, by the runs that it continues.
        seconds: time they used [s].
    """
    left = _million(config.num_steps - update * config.steps_per_update)
    steps = f"{left} M steps"
    if not config.minutes:
        return f"trains for {steps}{_afterwards(config)[0]}"
    minutes = max(config.minutes - seconds / 60.0, 0.0)
    words, extra = _afterwards(config)
    return (
        f"trains for at most {minutes:.3g} min or {steps}{words}: at most "
        f"about {minutes + extra:.0f} min in all"
    )


def estimate(config: PPOConfig, update: int, seconds: float, rate: float) -> str:
    """When training ends at a rate.

    Args:
        config: of the run.
        update: updates made.
        seconds: time used [s].
        rate: steps per second, `steps_per_update` an update.
    """
    made, total = update * config.steps_per_update, _million(config.num_steps)
    budget = 60.0 * config.minutes
    needed = seconds + max(config.num_steps - made, 0) / rate
    if budget and needed > budget:
        reached = _million(made + rate * max(budget - seconds, 0.0))
        end = f"{config.minutes:.3g} min, {reached} of {total} M steps"
    else:
        end = f"{needed / 60.0:.1f} min, {total} M steps"
    return f"at {rate:,.0f} steps/s: {end}"


def _afterwards(config: PPOConfig) -> tuple[str, float]:
    """What follows the training, and how long it takes on slow cores [min]."""
    parts = [
        (verb, minutes)
        for verb, minutes, wanted in (
            ("evaluates", EVALUATION_MINUTES, config.eval_episodes),
            ("renders", VIDEO_MINUTES, config.video_seconds),
        )
        if wanted
    ]
    if not parts:
        return "", 0.0
    return f", then {' and '.join(verb for verb, _ in parts)}", sum(
        minutes for _, minutes in parts
    )


def _million(steps: float) -> str:
    return f"{max(steps, 0.0) / 1e6:.3g}"
