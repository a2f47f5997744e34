"""Measured and modelled output and residuals of every trial, for figures.

`traces.h5`: measured and modelled output of every trial of a diagnosis, for `needleplan view` and other programs.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import h5py
import numpy as np
from numpy.typing import NDArray

from needleplan.artifacts import ShortRepr, version
from needleplan.diagnosis import Diagnosis, MotionPhase, motion_phases, residuals_of
from needleplan.models import Channel
from needleplan.signals import UNITS, Array, Motion, Role

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["TRACES_SCHEMA", "TrialTrace", "correlation", "gap_map", "trace_bytes", "traces_of"]


# Number of depth bins of the map.
_DEPTHS = 10
# Number of samples below which the mean square of a bin is NaN.
_FEWEST = 5


@dataclass(frozen=True)
class TrialTrace(ShortRepr):
    """Measured and modelled outputs of one trial, with the model before and after adding effects.

    `measured`, `before` and `after` have shape (axes, samples). `left_before` and `left_after` are the whitened
    residuals, shape (n,); `sample` holds the sample index of each of their values.
    """

    trial: str
    role: Role
    motion: Motion
    measured: Array
    before: Array
    after: Array | None
    """Output of the model with the effects of the most probable set; None if none was added."""

    left_before: Array
    left_after: Array | None
    sample: NDArray[np.intp]

    @property
    def held_out(self) -> bool:
        """Whether the trial validates the effects."""
        return self.role is Role.HOLDOUT

    @property
    def words(self) -> str:
        """The role of the trial in words."""
        return {Role.HOLDOUT: "held out", Role.REFERENCE: "reference"}.get(self.role, "training")


def traces_of(found: Diagnosis) -> tuple[TrialTrace, ...]:
    """Return the traces of the training trials, followed by those of the held-out trials and of the references.

    "Before" is the fit without effects. "After" is the fit of the most probable set; it is missing if no effect is
    named, unless only missing data prevent a name.
    """
    before, after, shown = found.nothing, found.named, found.shows_effects
    left_before, left_after = residuals_of(before, after), residuals_of(after)
    traces = []
    for number, (case, other) in enumerate(zip(before.trials, after.trials, strict=True)):
        samples = len(case.motion)
        traces.append(
            TrialTrace(
                case.record.trial, case.record.role, case.motion, case.measured.reshape(-1, samples),
                case.predicted.reshape(-1, samples), other.predicted.reshape(-1, samples) if shown else None,
                left_before[number], left_after[number] if shown else None, case.samples(),
            )
        )  # fmt: skip
    return tuple(traces)


def gap_map(traces: Sequence[TrialTrace], *, after: bool) -> tuple[tuple[MotionPhase, ...], Array, Array]:
    """Return phases of motion, edges of depth bins (mm), and the mean square of the whitened residual in each bin.

    The mean square has shape (phases, depth bins). It is 1 for noise alone and NaN in a bin with fewer than 5 samples.
    A phase without any bin of 5 samples is left out. If `after`, the residuals of the model with effects are used, or,
    if no effects were added, the residuals before.
    """
    deepest = max(float(trace.motion.depth_mm.max()) for trace in traces)
    edges = np.linspace(min(0.0, *(float(trace.motion.depth_mm.min()) for trace in traces)), deepest, _DEPTHS + 1)
    order = list(MotionPhase)
    total, count = np.zeros((len(order), _DEPTHS)), np.zeros((len(order), _DEPTHS))
    for trace in traces:
        left = trace.left_after if after and trace.left_after is not None else trace.left_before
        depth = np.clip(np.searchsorted(edges, trace.motion.depth_mm[trace.sample], side="right") - 1, 0, _DEPTHS - 1)
        phase = np.array([order.index(name) for name in motion_phases(trace.motion)[trace.sample].tolist()])
        np.add.at(total, (phase, depth), left**2)
        np.add.at(count, (phase, depth), 1)
    visited = np.flatnonzero((count >= _FEWEST).any(axis=1))
    energy = np.where(count >= _FEWEST, total / np.maximum(count, 1), np.nan)
    return tuple(order[index] for index in visited), edges, energy[visited]


def correlation(traces: Sequence[TrialTrace], lags: int, *, after: bool) -> tuple[Array, float]:
    """Return the autocorrelation of the whitened residuals at lags 1 to `lags`, and the 99 % bound of white noise.

    The autocorrelation of all trials together has shape (lags,). `after` selects the residuals as in `gap_map`.
    """
    rows = [trace.left_after if after and trace.left_after is not None else trace.left_before for trace in traces]
    products = np.array([sum(float(row[lag:] @ row[:-lag]) for row in rows) for lag in range(1, lags + 1)])
    samples = sum(map(len, rows))
    return products / max(sum(float(row @ row) for row in rows), 1e-12), 2.576 / float(np.sqrt(samples))


TRACES_SCHEMA = "needleplan.traces/1"
"""Attribute `schema` of `traces.h5`."""


def trace_bytes(channel: Channel, diagnosis: str, traces: Sequence[TrialTrace], next_: Motion | None) -> bytes:
    """Return the content of `traces.h5`: one group for each trial, in the order of `traces`, and the next motion.

    `diagnosis` is the digest of the diagnosis.

    A group `trial N` has the attributes `trial` and `role` and the datasets `time_s`, `depth_mm`, and `measured`,
    `before` and `after` of shape (axes, samples) in the unit of the channel. `after` is missing if no effect was added.
    """
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        file.attrs["schema"] = TRACES_SCHEMA
        file.attrs["made_by"] = f"needleplan {version()}"
        file.attrs["diagnosis"] = diagnosis
        file.attrs["columns"] = list(channel.columns)
        file.attrs["unit"] = UNITS[channel.columns[0]]
        for number, each in enumerate(traces):
            group = file.create_group(f"trial {number}")
            group.attrs["trial"] = each.trial
            group.attrs["role"] = str(each.role)
            _put(group, "time_s", each.motion.time_s)
            for name in ("measured", "before", "after"):
                if (values := getattr(each, name)) is not None:
                    _put(group, name, values)
            _put(group, "depth_mm", each.motion.depth_mm)
        if next_:
            group = file.create_group("next motion")
            _put(group, "time_s", next_.time_s)
            _put(group, "depth_mm", next_.depth_mm)
    return content.getvalue()


def _put(group: h5py.Group, name: str, values: ArrayLike) -> None:
    kind = np.float64 if name == "time_s" else np.float32
    group.create_dataset(name, data=np.asarray(values, kind), compression="gzip", shuffle=True)
