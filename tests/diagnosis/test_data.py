"""Unusable or missing data: they are reported, and no effect is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from needleplan.diagnosis import Lack, Library, Verdict, diagnose
from needleplan.diagnosis.data import check_data
from needleplan.errors import DataError
from needleplan.models import Channel
from needleplan.models.effects import effect_named
from needleplan.signals import Array, Record, Role
from tests.diagnosis.trials import BASE, recordings

LIBRARY = Library([effect_named("viscous"), effect_named("bias")], BASE)
DATA = recordings({"viscous": {"size": 3e-4}}, seed=4)
MOVING = (Role.TRAIN, Role.HOLDOUT)


def changed(name: str, change: Callable[[Array], Array], roles: tuple[Role, ...] = MOVING) -> list[Record]:
    return [each.with_column(name, change(each[name])) if each.role in roles else each for each in DATA]


def with_holes(values: Array) -> Array:
    return np.where(np.random.default_rng(0).random(len(values)) < 0.05, np.nan, values)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (changed("depth_mm", lambda depth: -depth), "Depth counts inwards"),
        (changed("depth_mm", lambda depth: depth - 100), "the tip is not in the tissue"),
        (changed("time_s", lambda time: np.cumsum(0.02 + 0.015 * (-1) ** np.arange(len(time)))), "unevenly"),
        ([*DATA[:3], replace(DATA[1], role=Role.NOISE, trial="noise")], "a noise record is of a needle at rest"),
        ([each.select(slice(0, 60)) for each in DATA], "too short"),
        (DATA[2:], "nothing to diagnose"),
        ([*DATA[:3], DATA[3].with_column("time_s", 2 * DATA[3]["time_s"])], "--rate HZ interpolates all trials"),
        ([DATA[0].select(np.r_[0:200, 300 : len(DATA[0])]), *DATA[1:]], "after 3.98 s, between samples every 0.02 s"),
    ],
)
def test_unusable_data_are_refused(data: list[Record], says: str) -> None:
    with pytest.raises(DataError, match=says):
        check_data(data, Channel.FORCE)


@pytest.mark.parametrize("factor", [1e-3, 30.0])
def test_a_noise_record_of_another_sensor_is_not_used(factor: float) -> None:
    checked = check_data(changed("force_n", lambda force: factor * force, (Role.NOISE,)), Channel.FORCE)
    assert checked.noise == ()
    assert "does not match the trials" in checked.lacks[Lack.NOISE]


@pytest.mark.parametrize("factor", [pytest.param(0.05, marks=pytest.mark.slow), 20.0])
def test_another_needle_gets_no_name(factor: float) -> None:
    """Calibration takes it up and the effect fits, but sizes are not those of the needle that was asked about."""
    found = diagnose(BASE, changed("force_n", lambda force: factor * force, tuple(Role)), library=LIBRARY)
    assert found.verdict is Verdict.AMBIGUOUS
    assert not found.effects
    assert found.lacks_data
    assert set(found.checked.lacks) == {Lack.NEEDLE}


@pytest.mark.slow
def test_rows_without_a_reading_are_left_out() -> None:
    found = diagnose(BASE, changed("force_n", with_holes), library=LIBRARY)
    assert found.names == ("viscous",)
    size = found.effects[0].estimates["size"]
    assert size.low < 3e-4 < size.high
