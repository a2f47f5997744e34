"""Records of insertions made with the published parameters."""

import numpy as np

from needleplan.estimation import JointForce
from needleplan.models import simulate
from needleplan.models.force import DepthForce
from needleplan.signals import Array, Motion, MovingAverage, Record, insertion_cycles
from needleplan_thesis.chapter2.forces import PUBLISHED_FORCES

AVERAGE = MovingAverage(5)


def recorded(
    model: DepthForce, velocity: float = 10.0, depth: float = 80.0, noise_n: float = 1.9e-3, seed: int = 0
) -> Record:
    """One insertion and retraction at 200 Hz; noise after the sensor's average."""
    motion = insertion_cycles(depth, velocity)
    white = noise_n * 5**0.5 * np.random.default_rng(seed).standard_normal(len(motion))
    return as_record(motion, AVERAGE.apply(simulate(model, motion).output + white))


def as_record(motion: Motion, force_n: Array) -> Record:
    return Record({
        "time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s, "force_n": force_n,
    })  # fmt: skip


def moved(model: DepthForce, factors: dict[str, float]) -> DepthForce:
    """The model with parameters wrong by factors; f1 in its distance from the bound that keeps g positive."""
    floor = max(0.0, -model.f2)
    values = {name: getattr(model, name) * factor for name, factor in factors.items()}
    if "f1" in factors:
        values["f1"] = floor + (model.f1 - floor) * factors["f1"]
    return model.with_values(**values)


MODEL = PUBLISHED_FORCES[0].model
JOINT = JointForce(MODEL)
