"""Faults of a recorded force before a fit: spikes, a saturated sensor, a flipped sign.

- **Standstill, spikes and saturation**: see `needleplan.signals.fault_notes`. The samples are left out.
- **Flipped sign**: a force that resists the motion is positive on the way in and smaller on the way out. The sign is
  wrong if the median on the way in is negative and, if there is a way out, the median on the way out is larger. It is
  reported, not corrected, because the zero of the sensor could be wrong as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needleplan.signals import Record, saturated_samples, spike_samples, still_parts

__all__ = ["without_faults"]


def without_faults(records: Sequence[Record]) -> tuple[tuple[Record, ...], list[str]]:
    """Return the records with faulty samples set to NaN, and remarks that name every fault."""
    kept, remarks = [], []
    for given in records:
        record, force = given, given["force_n"].copy()
        parts = still_parts(force, record["depth_mm"])
        for first, last in parts:
            force[first:last] = np.nan
        spikes, limited = spike_samples(force), saturated_samples(force)
        prefix = f"{record.trial}: " if record.trial else ""
        if parts:
            first = parts[0][0]
            remarks.append(
                f"{prefix}the reading stands still at {record['force_n'][first]:.4g} N from "
                f"{record['time_s'][first]:.4g} s on: {sum(last - first for first, last in parts)} samples in "
                f"{len(parts)} part{'s' * (len(parts) > 1)} are left out"
            )
            record = record.with_column("force_n", force)
        if spikes.any():
            at, most = float(record["time_s"][spikes][0]), float(np.max(np.abs(force[spikes])))
            remarks.append(
                f"{prefix}{int(spikes.sum())} samples are spikes of up to {most:.3g} N, the first at {at:.4g} s; they "
                "are left out"
            )
        if limited.any():
            ends = sorted({float(number) for number in force[limited]})
            named = " and ".join(f"{end:.4g} N" for end in ends)
            remarks.append(
                f"{prefix}the sensor is saturated at {named}: {int(limited.sum())} samples have exactly this value; "
                "they are left out, and the true force there is larger"
            )
        bad = spikes | limited
        sound = record.with_column("force_n", np.where(bad, np.nan, force)) if bool(bad.any()) else record
        if _flipped(sound):
            remarks.append(
                f"{prefix}the force is negative on the way in: its sign is flipped, or its zero is wrong; a force that "
                "resists the insertion is positive. Change the sign in the data and identify again"
            )
        kept.append(sound)
    return tuple(kept), remarks


def _flipped(record: Record) -> bool:
    motion, force = record.motion(), record["force_n"]
    deep = motion.depth_mm > 0.25 * float(np.max(motion.depth_mm))
    inward, outward = (force[deep & (motion.direction * side > 0) & np.isfinite(force)] for side in (1, -1))
    if inward.size < 5 or float(np.median(inward)) >= 0:
        return False
    return outward.size < 5 or float(np.median(outward)) > float(np.median(inward))
