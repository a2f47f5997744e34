"""Subjects of the benchmark: channel, base model, blind campaign, and names in the library and in the blind data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from needleplan.models import Model, ShaftAndTip, SpatialBicycle
from needleplan.models.effects import SIZE
from tests.blind import force, path
from tests.blind.campaign import SMALL, Case, Purpose, campaign
from tests.blind.effect import ForceName
from tests.blind.outside import AXES
from tests.blind.path_campaign import SMALL_PATH, PathCase, path_campaign
from tests.blind.path_effect import PathName
from tests.blind.path_outside import PATH_AXES
from tests.blind.recording import DataSet
from tests.blind.truth import Truth

AnyCase = Case | PathCase


class SubjectName(StrEnum):
    """Channels that have a campaign."""

    FORCE = "force"
    TIP = "tip"


@dataclass(frozen=True)
class Subject:
    """A channel with its base model and blind data."""

    base: Model
    generate: Callable[[Any], tuple[DataSet, Truth]]
    cases: Callable[[Purpose, bool], Iterable[AnyCase]]
    axes: Mapping[Any, str]
    """Axis of every effect outside the library, by its name."""

    large: float
    """Size from which an effect is expected to be named, as a multiple of the noise."""

    called: Mapping[str, str] = field(default_factory=dict)
    """Name in the library of effects with another name in the blind data."""

    comparable: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """By effect: name of a parameter in the library to its name in the blind data, if both mean the same."""

    def empty(self, case: AnyCase) -> Any:
        """Return the specification of a data set without an effect, with the motions of `case`."""
        return type(case.spec)(seed=7, training=case.spec.training, held_out=case.spec.held_out)


SUBJECTS = {
    SubjectName.FORCE: Subject(
        base=ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05),
        generate=force.generate,
        cases=lambda purpose, small: campaign(purpose, SMALL if small else None),
        axes={name: str(axis) for name, axis in AXES.items()},
        large=1.0,
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
        cases=lambda purpose, small: path_campaign(purpose, SMALL_PATH if small else None),
        axes={name: {"rotation": "angle"}.get(str(axis), str(axis)) for name, axis in PATH_AXES.items()},
        large=5.0,
        called={PathName.RESPIRATION: "target_respiration"},
        comparable={"curvature_layer": {"depth_mm": "depth_mm"}},
    ),
}
