"""Puts faults into the library, one at a time, and says which tests find them.

    python tests/faults.py            # all, some ten minutes on two cores
    python tests/faults.py gae tyre   # those whose names contain a word

Works on a copy of the checkout. Exits with 1 if the tests of a fault do not fail.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]


class Fault(NamedTuple):
    """A wrong text in place of a right one that a file holds once; `tests` find it."""

    path: str
    right: str
    wrong: str
    tests: str


FAULTS = {
    "a box overlaps if one axis separates": Fault(
        "geometry/boxes.py",
        "meet(self.b_in_a, self.half_a, self.half_b) & meet(",
        "meet(self.b_in_a, self.half_a, self.half_b) | meet(",
        "geometry/test_geometry.py",
    ),
    "a Reeds-Shepp word is too short": Fault(
        "geometry/reeds_shepp.py",
        "share = (2.0 + other_rho) / 4.0",
        "share = (1.9 + other_rho) / 4.0",
        "geometry/test_geometry.py",
    ),
    "two agents park in one bay": Fault(
        "mdp/terminations.py",
        "in_bay = in_bay & ~(shared & in_bay).any(axis=1)",
        "in_bay = in_bay & ~(shared & ~in_bay).any(axis=1)",
        "mdp/test_terminations.py",
    ),
    "a crash counts although the car diverged": Fault(
        "mdp/terminations.py",
        "crashed = alive & hit & ~parked",
        "crashed = hit & ~parked",
        "mdp/test_terminations.py",
    ),
    "the time penalty is paid whole each step": Fault(
        "mdp/rewards.py",
        "share = 1.0 / config.episode.max_steps if term.per_step else 1.0",
        "share = 1.0",
        "mdp/test_rewards.py",
    ),
    "hits of groups are lost between instants": Fault(
        "mdp/collisions.py",
        "hit = them.hit(own, own_size).any(axis=2)",
        "hit = them.hit(own, own_size)[..., -1]",
        "mdp/test_collisions.py",
    ),
    "cars turn as with twice the wheelbase": Fault(
        "physics/bicycle.py",
        "turned = speed * jnp.sin(slip) / (wheelbase / 2) * dt",
        "turned = speed * jnp.sin(slip) / wheelbase * dt",
        "physics/test_bicycle.py",
    ),
    "brakes drive backwards": Fault(
        "physics/bicycle.py",
        "jnp.maximum(jnp.abs(driven) - brake / lever * dt, 0.0)",
        "(jnp.abs(driven) - brake / lever * dt)",
        "physics/test_bicycle.py",
    ),
    "tyres leave the friction circle": Fault(
        "physics/forces.py",
        "jnp.minimum(1.0, limit / jnp.sqrt(force_x**2 + force_y**2 + _TINY))",
        "jnp.minimum(1.0, limit / jnp.sqrt(force_x**2 + _TINY))",
        "physics/test_tyres.py physics/test_driving.py",
    ),
    "the steering is as fast as it likes": Fault(
        "vehicle/drive.py",
        "return steering + jnp.clip(target - steering, -limit, limit)",
        "return target",
        "vehicle",
    ),
    "a delay is a step too short": Fault(
        "vehicle/drive.py",
        "count = _whole_steps(sim, delay) + 2",
        "count = _whole_steps(sim, delay) + 1",
        "physics/test_control_steps.py",
    ),
    "cars begin in what stands": Fault(
        "spawning/placing.py",
        "return ~(meets & self.others).any(axis=-1) & ~self.touches(pose)",
        "return ~(meets & self.others).any(axis=-1)",
        "spawning/test_placing.py spawning/test_room.py",
    ),
    "lanes lead the wrong way": Fault(
        "layouts/build.py",
        "return stacked(x, y, yaw + jnp.array([0.0, jnp.pi])), lane",
        "return stacked(x, y, yaw), lane",
        "layouts/test_routes.py",
    ),
    "velocities of others are in the frame of the lot": Fault(
        "observations/tracked.py",
        "way = rotate(velocity[index], -own.pose_w[:, None, 2])",
        "way = velocity[index]",
        "observations/test_observations.py",
    ),
    "rays do not turn with the car": Fault(
        "observations/ranges.py",
        "direction = rotate(ahead, own_pose[:, None, 2])[:, None]",
        "direction = rotate(ahead, 0.0 * own_pose[:, None, 2])[:, None]",
        "observations/test_observation_options.py",
    ),
    "people push too weakly": Fault(
        "movers/bodies.py",
        "STRENGTH = 2.1",
        "STRENGTH = 0.21",
        "movers/test_pedestrians.py",
    ),
    "people take the whole gap": Fault(
        "movers/bodies.py",
        "free = jnp.maximum((gap - SPARE) / 2, 0.0)",
        "free = jnp.maximum(2.0 * (gap - SPARE), 0.0)",
        "movers",
    ),
    "pictures are mirrored": Fault(
        "cameras/rig.py",
        "left = width / 2 - 0.5 - np.arange(width)",
        "left = np.arange(width) + 0.5 - width / 2",
        "cameras",
    ),
    "a truncated episode is a terminated one": Fault(
        "training/ppo/collect.py",
        "truncation=rollout.truncated,",
        "truncation=0.0 * rollout.truncated,",
        "training/test_epochs.py",
    ),
    "probabilities forget the slope of tanh": Fault(
        "policy/distributions.py",
        "return _join(slope, jnp.zeros_like(index))",
        "return _join(0.0 * slope, jnp.zeros_like(index))",
        "policy/test_distributions.py",
    ),
    "intervals take lots for independent": Fault(
        "evaluation/aggregation.py",
        "low, high = wilson_interval(rate * trials, trials)",
        "low, high = wilson_interval(count, len(values))",
        "evaluation/test_aggregation.py",
    ),
    "a crash is a success in Gymnasium": Fault(
        "wrappers/gymnasium_env.py",
        "success, done = terminated & ~crashed, terminated | truncated",
        "success, done = terminated, terminated | truncated",
        "wrappers/test_gymnasium.py",
    ),
    "files are seen half written": Fault(
        "files.py",
        "temporary.replace(path)",
        "path.write_bytes(temporary.read_bytes())",
        "test_reading.py",
    ),
}


def found_by(fault: Fault, copy: Path) -> list[str]:
    """Tests of a copy of the checkout that fail with a fault; it is taken out again."""
    path = copy / "carpark_mj" / fault.path
    right = path.read_text()
    if right.count(fault.right) != 1:
        raise ValueError(f"{fault.path} must hold once: {fault.right}")
    path.write_text(right.replace(fault.right, fault.wrong))
    tests = [f"tests/{name}" for name in fault.tests.split()]
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-x", "-n", "0", "--tb=no", *tests],
            cwd=copy,
            capture_output=True,
            text=True,
            check=False,
        )
    finally:
        path.write_text(right)
    lines = done.stdout.splitlines()
    failed = [line.split()[1] for line in lines if line.startswith(("FAILED", "ERROR"))]
    if done.returncode == 1 and not failed:
        raise RuntimeError(done.stdout)
    return failed


def main(words: list[str]) -> int:
    """Prints a line for each fault."""
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        ignored = shutil.ignore_patterns(".*", "runs", "__pycache__")
        shutil.copytree(ROOT, copy, ignore=ignored)
        for name, fault in FAULTS.items():
            if words and not any(word in name for word in words):
                continue
            found = found_by(fault, copy)
            missed += not found
            print(f"{'found ' if found else 'MISSED'} {name}: {fault.path}", flush=True)
            print(*(f"       {test}" for test in found), sep="\n", flush=True)
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
