"""The law of insertions as a population: on series by another hand, beside a textbook, at its limits, and for users."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from needleplan.cli import main
from needleplan.errors import DataError
from needleplan.identification import curvature, new_series, next_insertion
from needleplan.identification.population import deviation_mm, typical_scatter
from needleplan.recording import write_records
from needleplan.signals import Record
from tests.blind.series import LENGTH_MM, Drift, Insertion, Series, drawn

# Series of each kind, and the range of the coverage: the standard error of 95 % is 1.5 %.
RUNS, LEAST, MOST = 200, 0.90, 0.99


def record(insertion: Insertion, name: str) -> Record:
    columns = {"time_s": insertion.depth_mm / 2, "depth_mm": insertion.depth_mm, "x_mm": insertion.depth_mm}
    return Record({**columns, "y_mm": insertion.y_mm, "z_mm": insertion.z_mm}, name)


def records(series: Series, name: str) -> list[Record]:
    return [record(each, f"{name} {number}") for number, each in enumerate(series.insertions)]


@pytest.mark.parametrize("drift", Drift)
def test_the_region_holds_the_next_tip_and_drifting_series_are_followed(drift: Drift) -> None:
    random, held, errors, means = np.random.default_rng(3), 0, 0.0, 0.0
    for _ in range(RUNS):
        tips = drawn(random, drift, 7, wander_rad=0.0).tips_mm
        found = next_insertion(tips[:-1], deviation_mm(LENGTH_MM))
        held += bool(((found.low <= tips[-1]) & (tips[-1] <= found.high)).all())
        errors += float(np.linalg.norm(found.values - tips[-1]))
        means += float(np.linalg.norm(tips[:-1].mean(axis=0) - tips[-1]))
    assert LEAST < held / RUNS < MOST
    assert errors < (1.04 if drift is Drift.STEADY else 0.9) * means


def test_a_steady_series_of_one_plane_is_student_s_prediction() -> None:
    """With q = 0 and one plane the law is textbook: t around the mean, with four more insertions of the scatter s0."""
    x, s0 = np.array([7.9, 8.4, 8.1]), 0.5
    found = next_insertion(x[:, None], s0, ordered=False)
    dof = 4 + 2
    sd = np.sqrt((4 * s0**2 + np.sum((x - x.mean()) ** 2)) / dof * (1 + 1 / 3))
    assert found.values[0] == pytest.approx(x.mean())
    assert found.high[0] - x.mean() == pytest.approx(stats.t.ppf(0.975, dof) * sd, rel=1e-4)


def test_a_known_level_is_the_limit_of_an_unknown_one() -> None:
    x = np.random.default_rng(0).normal(2, 0.5, (6, 1))
    flat, wide = next_insertion(x, 0.5), next_insertion(x, 0.5, level_sd=1e4)
    assert wide.values == pytest.approx(flat.values, abs=1e-3)
    none = next_insertion(np.empty((0, 2)), 0.5, level_sd=1.0)
    assert none.values.tolist() == [0.0, 0.0]
    assert none.high == pytest.approx(-none.low, rel=1e-3)
    assert none.high[0] > 0.5


def test_from_twenty_insertions_on_their_errors_set_the_region() -> None:
    random, held, runs = np.random.default_rng(5), 0, 200
    for _ in range(runs):
        # Far from normal: one insertion in eight is off by six scatters.
        x = random.normal(0, 0.3, (26, 2)) + 2.0 * (random.random((26, 1)) < 0.125)
        found = next_insertion(x[:-1], 0.5)
        assert found.checked == 24
        held += bool(((found.low <= x[-1]) & (x[-1] <= found.high)).all())
    assert 0.92 < held / runs < 0.99


def test_other_series_make_a_new_series_known() -> None:
    random = np.random.default_rng(6)
    series = [random.normal(0, 1.0, (1, 2)) + random.normal(0, 0.2, (4, 2)) for _ in range(6)]
    scatter = typical_scatter(series[:-1], 0.5)
    assert (scatter < 0.4).all()
    within = next_insertion(series[-1], scatter)
    few, many = (new_series(some, within, 1.5) for some in (series[-1:], series))
    assert (many.high - many.low < 0.7 * (few.high - few.low)).all()
    assert (many.high - many.low > within.high - within.low).all()


def test_what_is_no_series_is_refused() -> None:
    with pytest.raises(DataError, match="at least one insertion"):
        next_insertion(np.empty((0, 2)), 0.5)
    with pytest.raises(DataError, match="must be above 0"):
        next_insertion(np.ones((2, 1)), 0.0)


@pytest.mark.slow
def test_it_reaches_the_user(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    random = np.random.default_rng(7)
    jumped, steady = drawn(random, Drift.STEP, 7), drawn(random, Drift.STEADY, 3)
    now, before = str(tmp_path / "now.csv"), str(tmp_path / "before.csv")
    write_records(records(jumped, "now"), now)
    write_records(records(steady, "before"), before)
    assert main(["identify", "deflection", now, "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)["prediction"]
    assert main(["identify", "deflection", now, "--other-series", before, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)["prediction"]
    assert 0.5 < answer["drift"] <= 1.0
    low, high = answer["y_new_series_mm"]
    assert high - low < alone["y_new_series_mm"][1] - alone["y_new_series_mm"][0]
    assert main(["identify", "deflection", now, "--other-series", now]) == 2
    assert "is the same insertion as" in capsys.readouterr().err


def test_insertions_are_put_in_the_order_of_their_times() -> None:
    random = np.random.default_rng(8)
    begun = [100.0, 200.0, 300.0, 90000.0]
    made = [
        Record(each.columns, each.trial, begun_s=time)
        for each, time in zip(records(drawn(random, Drift.SLOPE, 4), "now"), begun, strict=True)
    ]
    one, other = (curvature.identify(some, segments=1, layers=1) for some in (made, made[::-1]))
    assert one.prediction == other.prediction
    assert any("order of their times: now 0, now 1, now 2, now 3" in each for each in other.remarks)
    assert not any("order of their times" in each for each in one.remarks)
    assert any("now 3 began 24.9 hours after now 2" in each for each in one.remarks)
