"""Unusable or missing data: they are reported, and no effect is named."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from needleplan.diagnosis import Lack, Library, Settings, Verdict, diagnose
from needleplan.diagnosis._diagnose import _affordable_rate
from needleplan.diagnosis.data import check_data, sensor_noise
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


def test_a_force_of_the_wrong_sign_is_refused_and_each_trial_is_named() -> None:
    with pytest.raises(DataError) as all_of_them:
        diagnose(BASE, changed("force_n", lambda force: -force), library=LIBRARY)
    assert [each.key for each in all_of_them.value.mistakes] == [f"force_n (trial {number})" for number in range(3)]
    with pytest.raises(DataError, match=r"force_n \(trial 2\): has the opposite sign"):
        diagnose(BASE, changed("force_n", lambda force: -force, (Role.HOLDOUT,)), library=LIBRARY)


def test_zeros_that_differ_between_trials_are_remarked() -> None:
    assert not any("zero of the sensor" in each for each in check_data(DATA, Channel.FORCE).remarks)
    shared = changed("force_n", lambda force: force + 0.05)
    assert not any("zero of the sensor" in each for each in check_data(shared, Channel.FORCE).remarks)
    shifted = [DATA[0].with_column("force_n", DATA[0]["force_n"] + 0.05), *DATA[1:]]
    (said,) = [each for each in check_data(shifted, Channel.FORCE).remarks if "zero of the sensor" in each]
    assert "N in trial 0: subtract the zero" in said


def test_long_trials_are_averaged_to_a_lower_rate_and_said_to_be() -> None:
    def stretched(factor: float) -> list[Record]:
        """Return trials of that many times as many samples as the data, of the same rate."""
        found = []
        for each in DATA[:3]:
            columns = {name: np.tile(each[name], round(factor)) for name in each.columns}
            columns["time_s"] = np.arange(len(columns["time_s"])) / 50
            found.append(Record(columns, each.trial, each.role))
        return found

    assert _affordable_rate(stretched(1), Settings()) == (60.0, [])
    long = stretched(8)
    seconds = sum(float(np.ptp(each["time_s"])) for each in long)
    rate_hz, remarks = _affordable_rate(long, Settings())
    assert 20 < rate_hz < 50
    assert rate_hz * seconds == pytest.approx(20_000)
    assert "to save memory" in remarks[0]
    with pytest.raises(DataError, match="s together: at most 1000 s"):
        _affordable_rate(stretched(20), Settings())


@pytest.mark.parametrize("factor", [1e-3, 30.0])
def test_a_noise_record_of_another_sensor_is_not_used(factor: float) -> None:
    checked = check_data(changed("force_n", lambda force: factor * force, (Role.NOISE,)), Channel.FORCE)
    assert checked.noise == ()
    assert "does not match the trials" in checked.lacks[Lack.NOISE]


@pytest.mark.slow
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


def test_readings_without_noise_have_a_noise_that_sums_of_squares_resolve() -> None:
    ramp = [trial.with_column("force_n", 0.02 * trial["depth_mm"]) for trial in DATA if trial.role is Role.TRAIN]
    noise = sensor_noise(BASE, check_data(ramp, Channel.FORCE))
    size = np.sqrt(np.mean([np.mean(trial["force_n"] ** 2) for trial in ramp]))
    assert 1e-7 < noise.sd / size < 1e-5
