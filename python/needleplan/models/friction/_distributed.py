"""The distributed LuGre model, solved along its characteristics: slow, and the reference for the averaged models.

Bristles sit on the needle and move with it along the patch. Each bristle obeys dz/dt = v - sigma0 |v| z/g(v) (thesis,
(3.1)), with z = 0 when the bristle enters the tissue at either end. The force is (3.4) with dz/dt at constant zeta,
integrated by parts as in (3.18)::

    F = int_0^L {(sigma0 - sigma0 sigma1 |v|/g) z + (sigma1 + sigma2) v} fn dzeta
        + sigma1 v [ int_0^L z fn' dzeta - z(L) fn(L) + z(0) fn(0) ]

All bristles obey the same linear equation and differ only in their time of entry. A step is therefore exact for all
bristles, except for the fraction of the step in which a bristle enters. The integrals are sums over bristles
`spacing_mm` apart. At 0.1 mm the rms error is 0.2 mN for the trapezoids. The uniform force has sharp ends, and its
error is 1.2 mN.
"""

from __future__ import annotations

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.models.friction._base import Profile, intensity, normal_length_mm
from needleplan.models.friction._lugre import LuGre
from needleplan.signals import Array, Motion

__all__ = ["distributed"]

# Number of samples that are computed at once; limits the use of memory.
_BLOCK = 200


def distributed(model: LuGre, motion: Motion, profile: Profile, spacing_mm: float = 0.1) -> Array:
    """Return the friction of the distributed bristles of a model along a motion, from rest.

    Parameters
    ----------
    model : LuGre
        Parameters and patch; its beta is not used.
    motion : Motion
        The motion.
    profile : Profile
        Distribution of the normal force; CONSTANT counts as UNIFORM. If the profile of `model` is CONSTANT, the total
        force of `model` is distributed in this way at every length.
    spacing_mm : float
        Distance between bristles. The first bristle is half of this distance behind the tip.

    Returns
    -------
    Array
        Friction (N), shape (samples,).

    Raises
    ------
    ModelError
        If the spacing is not positive, or larger than a third of the ramp.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> model = npl.models.LumpedLuGre(mu_c=0.73, sigma2=0.016, sigma0=1.3, sigma1=0.46, mu_s=0.034, alpha=0.09)
    >>> motion = insertion_cycles(10.0, 5.0, rate_hz=50.0)
    >>> force = npl.models.distributed(model, motion, npl.models.Profile.ISOSCELES, spacing_mm=0.5)
    >>> force.shape == motion.depth_mm.shape
    True
    """
    if not 0 < spacing_mm <= model.ramp_mm / 3:
        rule = f"must be positive and at most a third of the ramp of {model.ramp_mm:g} mm"
        raise ModelError(Mistake("spacing_mm", f"{spacing_mm:g}", rule), "distributed")
    nearest = max(float(np.min(motion.depth_mm)) - model.thickness_mm, 0.0)
    deepest = max(float(np.max(motion.depth_mm)), nearest + spacing_mm)
    behind_tip: Array = (
        np.arange(int(nearest / spacing_mm), int(np.ceil(deepest / spacing_mm)), dtype=float) + 0.5
    ) * spacing_mm
    decay, gain = _steps(model, motion)
    bending = np.zeros_like(behind_tip)
    forces = []
    for begin in range(0, len(motion), _BLOCK):
        block = np.arange(begin, min(begin + _BLOCK, len(motion)))
        states = np.zeros((behind_tip.size, block.size))
        for column, sample in enumerate(block[block > 0], start=int(begin == 0)):
            before, after = motion.depth_mm[sample - 1] - behind_tip, motion.depth_mm[sample] - behind_tip
            share = _share_inside(before, after, model.thickness_mm)
            # A bristle that enters during a step gets its share of the step; all others get the exact factors.
            entering = (share > 0) & (share < 1)
            bending = decay[sample - 1] * bending + gain[sample - 1]
            bending[entering] = share[entering] * gain[sample - 1]
            bending[(after <= 0) | (after >= model.thickness_mm)] = 0.0
            states[:, column] = bending
        forces.append(_force(model, motion[block], profile, states, behind_tip, spacing_mm))
    return np.concatenate(forces)


def _steps(model: LuGre, motion: Motion) -> tuple[Array, Array]:
    """Return factor and summand (mm) of the bending for each interval, shape (samples - 1,) each.

    The coefficients are those of the middle of the interval.
    """
    middle = motion.between(0.5)
    rate = model.sigma0 * np.abs(middle.velocity_mm_s) / model.level(middle)
    decay = rate * motion.interval_s
    small = decay < 1e-9
    phi = np.where(small, 1.0, -np.expm1(-decay) / np.where(small, 1.0, decay))
    return np.exp(-decay), middle.velocity_mm_s * motion.interval_s * phi


def _share_inside(before: Array, after: Array, thickness: float) -> Array:
    """Return the share of a step that each bristle spends in the tissue, shape (bristles,)."""
    moved = after - before
    length = np.where(moved == 0, 1.0, np.abs(moved))
    inside = np.clip(np.maximum(before, after), 0, thickness) - np.clip(np.minimum(before, after), 0, thickness)
    return np.where(moved == 0, (after > 0) & (after < thickness), np.clip(inside / length, 0, 1))


def _force(model: LuGre, motion: Motion, profile: Profile, states: Array, behind_tip: Array, spacing: float) -> Array:
    length = model.inserted_mm(motion)
    speed, velocity = np.abs(motion.velocity_mm_s), motion.velocity_mm_s
    position = motion.depth_mm - behind_tip[:, None]
    shape = intensity(profile, position, length, model.ramp_mm)
    weight = shape * spacing
    total = normal_length_mm(Profile.UNIFORM if profile is Profile.CONSTANT else profile, length, model.ramp_mm)
    # The weights always add up to the normal force, although the cells at the ends are partly outside.
    added = weight.sum(axis=0)
    weight *= np.where(added > 0, total / np.where(added > 0, added, 1.0), 0.0)
    mean = (states * weight).sum(axis=0)
    bent = (model.sigma0 - model.sigma0 * model.sigma1 * speed / model.level(motion)) * mean
    carried = model.sigma1 * velocity * _by_parts(model, motion, profile, states, position, length, spacing)
    ratio = bent + (model.sigma1 + model.sigma2) * velocity * total + carried
    if model.profile is Profile.CONSTANT:
        return np.asarray(model.normal_force_n * ratio / np.where(total > 0, total, 1.0))
    reference = normal_length_mm(profile, np.asarray(model.reference_mm), model.ramp_mm)
    return np.asarray(model.normal_force_n / float(reference) * ratio)


def _by_parts(
    model: LuGre, motion: Motion, profile: Profile, states: Array, position: Array, length: Array, spacing: float
) -> Array:
    """Return the term of (3.18) that integration by parts gives (mm), shape (samples,).

    The term is int z fn' dzeta - z(L) fn(L) + z(0) fn(0): z is the bending of the bristles (mm) at the place zeta
    from the entry, and fn the normal force per length over its plateau f. fn is 0 at both ends (ISOSCELES), at the
    entry alone (RIGHT), or at neither end (other profiles). Row i of `states` and `position` belongs to bristle i,
    counted from the tip.
    """
    ramp = model.ramp_mm
    inside = (position > 0) & (position < length)
    if profile is Profile.ISOSCELES:
        rising = inside & (position < np.minimum(ramp, length / 2))
        falling = inside & (position > np.maximum(length - ramp, length / 2))
        return np.asarray(((rising * states).sum(axis=0) - (falling * states).sum(axis=0)) * spacing / ramp)
    # Bristles that enter the tissue at an end have no bending: z is 0 at this end.
    columns, any_inside = np.arange(states.shape[1]), inside.any(axis=0)
    bent_at_far_end = (motion.velocity_mm_s > 0) | (motion.depth_mm <= model.thickness_mm)
    z_far = np.where(any_inside & bent_at_far_end, states[np.argmax(inside, axis=0), columns], 0.0)
    if profile is Profile.RIGHT:
        rising = inside & (position < ramp)
        return np.asarray((rising * states).sum(axis=0) * spacing / ramp - z_far * np.minimum(length / ramp, 1))
    last = position.shape[0] - 1 - np.argmax(inside[::-1], axis=0)
    z_entry = np.where(any_inside & (motion.velocity_mm_s < 0), states[last, columns], 0.0)
    return z_entry - z_far
