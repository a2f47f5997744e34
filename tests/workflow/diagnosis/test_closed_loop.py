from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest

from needleplan.diagnosis import Diagnosis
from needleplan.models import SpatialBicycle
from needleplan.models.effects import AddedEffect
from needleplan.scenario import Scenario
from needleplan.signals import Role
from needleplan.workflow.diagnosis.closed_loop import recognised, recordings
from needleplan.workflow.diagnosis.hidden import HIDDEN, laboratory

SCENARIO = Scenario.read("prostate")
BEND = 1 / SCENARIO.needle.curvature_radius_mm


@dataclass
class Found:
    """What is read of a diagnosis."""

    base: SpatialBicycle
    effects: tuple[Any, ...]


@dataclass
class Named:
    added: AddedEffect


def found(name: str, **values: float) -> Diagnosis:
    return cast(Diagnosis, Found(SpatialBicycle(curvature_per_mm=BEND), (Named(AddedEffect(name, values)),)))


def test_a_layer_goes_to_the_planner() -> None:
    needle = recognised(found("curvature_layer", size=0.5, depth_mm=30.0), SCENARIO).scenario.needle
    assert needle.curvature_radius_mm == pytest.approx(1 / BEND)
    (layer,) = needle.layers
    assert layer.curvature_radius_mm == pytest.approx(1 / BEND / 1.5)
    assert 29 < layer.from_mm < 30  # the path is longer than its way along x


def test_a_lag_goes_to_the_torsion_and_a_tilt_to_the_robot() -> None:
    lagging = recognised(found("torsional_lag", size=0.004), SCENARIO)
    assert lagging.torsion is not None
    middle = lagging.torsion.lag_rad(165.0, 35.0)
    assert middle == pytest.approx(0.004 * 35, rel=0.02)
    tilted = recognised(found("misalignment", size=-0.03, direction_rad=math.pi), SCENARIO)
    assert tilted.tilt_rad == pytest.approx(0.03)
    assert (tilted.torsion, tilted.scenario.needle.layers) == (None, ())


def test_what_is_of_the_tracker_changes_no_plan() -> None:
    known = recognised(found("tracker_bias", size=1.0, direction_rad=0.0), SCENARIO)
    assert (known.torsion, known.tilt_rad, known.scenario.needle.layers) == (None, 0.0, ())


def test_recordings_of_a_lab_have_what_a_diagnosis_asks_for() -> None:
    data = recordings(HIDDEN[0].hide(laboratory(BEND)))
    assert [each.role for each in data] == [Role.TRAIN] * 3 + [Role.HOLDOUT] * 2 + [Role.NOISE]
    for each in data[:5]:
        assert np.ptp(each["angle_rad"]) == pytest.approx(np.pi, abs=0.01)
        assert np.isfinite(each["z_mm"]).all()
        assert np.diff(each["time_s"]) == pytest.approx(0.025)
