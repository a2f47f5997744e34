"""What of a measured axial force is not friction: inertia of the needle, and cutting at the tip (thesis, 3.4.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needleplan.errors import Mistake, ModelError
from needleplan.models.friction.shaft import Friction
from needleplan.models.simulate import simulate
from needleplan.signals import Array, Motion, Record

__all__ = ["ForceParts", "cutting_force", "into_fresh_tissue"]

_N_PER_KG_MM_S2 = 1e-3


@dataclass(frozen=True)
class ForceParts:
    """The parts of the axial force (N), shape (samples,) each; they add up to what was measured."""

    friction_n: Array
    inertia_n: Array
    cutting_n: Array


def cutting_force(record: Record, friction: Friction, mass_kg: float) -> ForceParts:
    """Return the cutting force of a trial: measured - friction - inertia.

    `mass_kg` is the needle with its holder beyond the sensor. The sensor pushes the mass as well as the needle through
    the tissue, so inertia is mass times acceleration in the direction of insertion (the thesis' F = Fz + m a has its
    sensor axis the other way round); at 0.05 Hz it is 0.1 mN. The friction is simulated from rest along the record's
    motion. Raises DataError without `force_n`, ModelError for a mass that is negative or no number.
    """
    if not 0 <= mass_kg < np.inf:
        raise ModelError(Mistake("mass_kg", str(mass_kg), "must be a number that is not negative"), "cutting_force")
    measured = record["force_n"]
    motion = record.motion()
    rubbed = simulate(friction, motion).output
    inertia = _N_PER_KG_MM_S2 * mass_kg * np.gradient(motion.velocity_mm_s, motion.time_s)
    return ForceParts(rubbed, inertia, measured - rubbed - inertia)


def into_fresh_tissue(motion: Motion, margin_mm: float = 0.0) -> NDArray[np.bool_]:
    """Return where the tip is deeper than ever before, less `margin_mm`, and moving in: where it cuts; bool (samples,).

    The first sample counts as reached before.
    """
    reached = np.concatenate([[motion.depth_mm[0]], np.maximum.accumulate(motion.depth_mm)[:-1]])
    return np.asarray((motion.depth_mm > reached - margin_mm) & (motion.velocity_mm_s > 0))
