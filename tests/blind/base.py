"""The needle and the tissue without any hidden effect: nominal numbers, and what differs from trial to trial."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tests.blind.contact import CENTRES_MM, EDGES_MM, ELEMENTS, Compliance, Contact
from tests.blind.motions import STEP_S, Array, Trajectory

FRICTION_N_MM = 0.012
CUTTING_N = 0.4
ONSET_MM = 4.0
PRESLIDING_MM = 0.05
NODE_MM, NODE_S = 0.003, 0.02
SCATTER = 0.15  # of friction and of cutting, each on its own, uniform, per trial
PRESLIDING_SCATTER = 0.10
CORRELATION_MM = 5.0  # of the tissue's heterogeneity along the path


@dataclass(frozen=True)
class Specimen:
    """Tissue of R trials: friction per element in N/mm and cutting force in N, both (R, ELEMENTS), and compliance."""

    friction_n_mm: Array
    cutting_n: Array
    compliance: Compliance


@dataclass(frozen=True)
class Scene:
    """What an effect can see: (T,) or (T, R) arrays of motion and contact. tip_mm is relative to the tissue."""

    time_s: Array
    depth_mm: Array
    velocity_mm_s: Array
    acceleration_mm_s2: Array
    tip_mm: Array
    contact: Contact
    specimen: Specimen

    @property
    def deepest_mm(self) -> Array:
        return np.maximum.accumulate(self.tip_mm, axis=0)

    @property
    def loaded(self) -> Array:
        """Share of its load that the tip carries: 1 while it advances, 0 after it has drawn back."""
        return 0.5 * (1.0 + self.contact.tip)

    @property
    def slip_mm_s(self) -> Array:
        return self.contact.slip_mm / STEP_S

    @property
    def onset(self) -> Array:
        return -np.expm1(-np.maximum(self.tip_mm, 0.0) / ONSET_MM)


def _along_path(rng: np.random.Generator) -> Array:
    """A field of unit variance whose correlation falls exponentially with the distance."""
    keep = np.exp(-(EDGES_MM[1] - EDGES_MM[0]) / CORRELATION_MM)
    values = rng.standard_normal(ELEMENTS)
    for i in range(1, ELEMENTS):
        values[i] = keep * values[i - 1] + np.sqrt(1.0 - keep**2) * values[i]
    return values


def specimen(seeds: Sequence[np.random.SeedSequence], heterogeneity: float) -> Specimen:
    """Tissue of as many trials as there are seeds; the numbers of a trial do not depend on the other trials."""
    friction, cutting, bristle = [], [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        scale = 1.0 + SCATTER * rng.uniform(-1, 1, 2)
        length = PRESLIDING_MM * (1.0 + PRESLIDING_SCATTER * rng.uniform(-1, 1))
        shaft, tip = _along_path(rng), _along_path(rng)
        friction.append(FRICTION_N_MM * scale[0] * (1.0 + heterogeneity * shaft))
        cutting.append(CUTTING_N * scale[1] * (1.0 + heterogeneity * tip))
        bristle.append(np.full(ELEMENTS + 1, length))
    give = np.full((len(seeds), ELEMENTS + 1), NODE_MM)
    return Specimen(np.array(friction), np.array(cutting), Compliance(np.array(bristle), give, NODE_S))


def stacked(trajectories: Sequence[Trajectory]) -> tuple[Array, Array, Array]:
    """Depth, speed, acceleration of the trials, each (T, R)."""
    columns = ("depth_mm", "velocity_mm_s", "acceleration_mm_s2")
    depth, velocity, acceleration = (
        np.stack([getattr(each, name) for each in trajectories], axis=1) for name in columns
    )
    return depth, velocity, acceleration


def base_force_n(scene: Scene) -> tuple[Array, Array]:
    """Friction along the shaft and cutting at the tip, each (T, R)."""
    contact, tissue = scene.contact, scene.specimen
    friction = np.einsum("trn,trn,rn->tr", contact.covered_mm, contact.bristle, tissue.friction_n_mm)
    local = np.stack(
        [np.interp(scene.tip_mm[:, r], CENTRES_MM, each) for r, each in enumerate(tissue.cutting_n)], axis=1
    )
    return friction, local * scene.onset * scene.loaded
