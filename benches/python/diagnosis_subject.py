"""Subjects of the benches: channel, base model, blind campaign, and names in the library and in the blind data."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from needleplan.models import Model, ShaftAndTip, SpatialBicycle
from needleplan.models.effects import SIZE
from needleplan.signals import Record, Role
from tests.blind import force, path
from tests.blind.effect import ForceName
from tests.blind.path_effect import PathName
from tests.blind.recording import DataSet
from tests.blind.truth import Truth


def records(data: DataSet) -> list[Record]:
    """Return the trials of a data set as records."""
    return [
        Record(
            {name: values for name, values in each.columns.items() if values.dtype.kind == "f"},
            each.name,
            Role(each.role.value),
        )
        for each in data.trials
    ]


class SubjectName(StrEnum):
    """Channels that have a campaign."""

    FORCE = "force"
    TIP = "tip"


@dataclass(frozen=True)
class Subject:
    """A channel with its base model and blind data."""

    base: Model
    generate: Callable[[Any], tuple[DataSet, Truth]]
    called: Mapping[str, str] = field(default_factory=dict)
    """Name in the library of effects with another name in the blind data."""

    comparable: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """By effect: name of a parameter in the library to its name in the blind data, if both mean the same."""


SUBJECTS = {
    SubjectName.FORCE: Subject(
        base=ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05),
        generate=force.generate,
        called={ForceName.CUTTING_DEPTH: "cutting_with_depth", ForceName.GAIN: "gain_error", ForceName.BUMPS: "bump"},
        comparable={
            "viscous": {SIZE: SIZE},
            "bias": {SIZE: SIZE},
            "drift": {SIZE: SIZE},
            "latency": {SIZE: SIZE},
            "inertia": {SIZE: SIZE},
            "cutting_with_depth": {SIZE: SIZE},
            "friction_layer": {SIZE: SIZE, "depth_mm": "depth_mm"},
            "cutting_layer": {SIZE: SIZE, "depth_mm": "depth_mm"},
            "puncture": {"depth_mm": "depth_mm"},
            "thermal_drift": {SIZE: SIZE, "time_s": "settling_s"},
            "respiration": {SIZE: SIZE},
        },
    ),
    SubjectName.TIP: Subject(
        base=SpatialBicycle(curvature_per_mm=1 / 250),
        generate=path.generate,
        called={PathName.RESPIRATION: "target_respiration"},
        comparable={"curvature_layer": {"depth_mm": "depth_mm"}},
    ),
}
