"""What is wrong, disturbed or noisy in the lab twin: one size an effect, and 0 means that it is not there."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from typing import Any

from needleplan.config import ConfigTable, Number, ruled
from needleplan.errors import ExperimentError

__all__ = ["Effects"]


def _size(unit: str, at_most: float, default: float = 0.0, *, signed: bool = False) -> Any:
    return ruled(Number(unit, at_least=-at_most if signed else 0.0, at_most=at_most), default)


def _scale(unit: str, at_most: float, default: object = MISSING) -> Any:
    return ruled(Number(unit, above=0, at_most=at_most), default)


@dataclass(frozen=True)
class Effects(ConfigTable, key="effects", error=ExperimentError):
    """Sizes of all effects; the scales of time and length that go with them have defaults that are not 0."""

    curvature_error: float = _size("", 0.95, signed=True)
    """Share by which the true curvature is above that of the plan, everywhere."""

    curvature_scatter: float = _size("", 0.5)
    """Standard deviation of that share from one insertion (seed) to the next."""

    curvature_speed_power: float = _size("", 1, signed=True)
    """Power of the speed, over 5 mm/s, with which the curvature grows: rate-dependent tissue."""

    pre_bend_per_mm: float = _size("1/mm", 0.1, signed=True)
    """Curvature of a needle that was bent before, across its bevel; it turns with the tip."""

    sag_per_mm: float = _size("1/mm", 0.1, signed=True)
    """Curvature downwards at the entry by the weight of the needle outside; in proportion to what is still outside."""

    heading_noise_rad_sqrt_mm: float = _size("rad/sqrt(mm)", 0.1)
    """Standard deviation of the heading after 1 mm of fresh tissue, in the plane and out of it; grows as a root."""

    torsional_friction_n: float = _size("N mm/mm", 10)
    """Torque per inserted length that tissue resists rotation with."""

    tissue_compliance_mm_n: float = _size("mm/N", 100)
    """How far the tissue gives way along the needle under 1 N."""

    tissue_relaxation_s: float = _scale("s", 100, 0.2)
    """Damping over stiffness of what holds the tissue."""

    respiration_along_mm: float = _size("mm", 30)
    """Amplitude of the breathing along the entry."""

    respiration_across_mm: float = _size("mm", 30)
    """Amplitude of the breathing across the entry, to the left."""

    respiration_period_s: float = _scale("s", 60, 4.0)

    encoder_step_mm: float = _size("mm", 0.1)
    """Resolution of the insertion axis."""

    encoder_step_rad: float = _size("rad", 0.1)
    """Resolution of the roll axis."""

    reaction_mm_s2_n: float = _size("mm/s^2/N", 1e4)
    """How a force on the needle accelerates the insertion axis: one over its mass."""

    force_noise_n: float = _size("N", 1)
    """Standard deviation of a sample before the moving average."""

    force_offset_n: float = _size("N", 10, signed=True)
    force_drift_n_s: float = _size("N/s", 0.1, signed=True)
    force_gain_error: float = _size("", 0.5, signed=True)

    tracker_noise_mm: float = _size("mm", 5)
    """Standard deviation along each axis, independent from frame to frame."""

    tracker_wander_mm: float = _size("mm", 5)
    """Standard deviation along each axis of an error that changes slowly."""

    tracker_wander_s: float = _scale("s", 1000, 1.0)
    """Time over which that error is forgotten to 1/e."""

    tracker_distortion_mm: float = _size("mm", 20)
    """Amplitude of a smooth distortion of the field, fixed in space."""

    tracker_distortion_length_mm: float = _scale("mm", 1e4, 200.0)
    """Wavelength of the distortion."""

    tracker_angle_noise_rad: float = _size("rad", 0.5)
    """Standard deviation of the direction of the coil, about each axis across it."""

    tracker_dropout: float = _size("", 1)
    """Probability for a frame to begin a dropout."""

    tracker_dropout_s: float = _scale("s", 60, 0.1)
    """Mean length of a dropout."""

    coil_offset_mm: float = _size("mm", 50)
    """How far the coil sits behind the tip."""
