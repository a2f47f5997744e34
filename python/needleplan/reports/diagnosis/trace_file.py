"""`traces.h5`: measured and modelled output of every trial of a diagnosis, for `needleplan view` and other programs."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

import h5py
import numpy as np

from needleplan.artifacts import version
from needleplan.models import Channel
from needleplan.reports.diagnosis.traces import TrialTrace
from needleplan.signals import UNITS, Motion

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["TRACES_SCHEMA", "trace_bytes"]

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
