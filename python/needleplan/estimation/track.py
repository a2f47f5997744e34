"""What a filter said along a record: predictions, innovations and the tracks of +-3 standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needleplan.estimation.joint import Joint
from needleplan.estimation.joint_filter import JointFilter
from needleplan.estimation.sample import Sample, Step, Use
from needleplan.signals import Array, Record

__all__ = ["Track", "feed", "track_of"]


@dataclass(frozen=True)
class Track:
    """What a filter said along one record; every array has the shape (samples,).

    `values` holds for every free parameter its lower limit, estimate and upper limit: the estimate -+ 3 standard
    deviations in coordinates, carried back. `state` is the same for the first state, if there is one.
    """

    time_s: Array
    depth_mm: Array
    predicted: Array
    innovation: Array
    innovation_sd: Array
    used: NDArray[np.bool_]
    values: dict[str, tuple[Array, Array, Array]]
    state: tuple[Array, Array, Array] | None

    def innovation_rmse(self, rows: NDArray[np.bool_] | None = None) -> float:
        """Return the root mean square of the innovations that were used, of all rows or of some; NaN for none."""
        chosen = self.innovation[self.used if rows is None else self.used & rows]
        return float(np.sqrt(np.mean(chosen**2))) if chosen.size else float("nan")


def feed(filtered: JointFilter, record: Record, settle: int = 0) -> list[Step]:
    """Feed one record, sample by sample, and return what the filter said; ends where it diverges.

    With `settle` the sample before each reversal is masked too, which a filter on line cannot know of. Raises DataError
    for a record without motion, or without the channel of the model.
    """
    motion = record.motion()
    measured = record[filtered.channel]
    masked = np.zeros(len(motion), bool)
    if settle:
        masked[:-1] = motion.direction[1:] * motion.direction[:-1] < 0
    columns = (motion.time_s, motion.depth_mm, measured, motion.velocity_mm_s, motion.angle_rad)
    steps = []
    for mask, *values in zip(masked.tolist(), *(each.tolist() for each in columns), strict=True):
        steps.append(filtered.update(Sample(*values), masked=mask))
        if steps[-1].use is Use.DIVERGED:
            break
    return steps


def track_of(joint: Joint, record: Record, steps: list[Step]) -> Track:
    """Return the steps of a record as arrays; shorter than the record where the filter diverged."""
    n = len(steps)
    x, sd = np.array([each.x for each in steps]), np.array([each.x_sd for each in steps])
    # [lower, estimate, upper] by [sample] by [parameter]
    limits = np.array([
        [list(joint.values(row).values()) for row in x + offset * sd] for offset in (-3.0, 0.0, 3.0)
    ])  # fmt: skip
    values = {name: (limits[0, :, k], limits[1, :, k], limits[2, :, k]) for k, name in enumerate(joint.free)}
    state = (x[:, 0] - 3 * sd[:, 0], x[:, 0], x[:, 0] + 3 * sd[:, 0]) if joint.states else None
    return Track(
        record["time_s"][:n], record["depth_mm"][:n], np.array([each.predicted for each in steps]),
        np.array([each.innovation for each in steps]), np.array([each.sd for each in steps]),
        np.array([each.use is Use.USED for each in steps]), values, state,
    )  # fmt: skip
