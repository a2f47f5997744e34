"""Trials from what callers have: tables of columns, files, lists of both; anything else is one clear error."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import needleplan as npl
from needleplan.errors import DataError, NeedleplanError
from needleplan.identification import curvature, force, friction, tissue_motion
from needleplan.recording import read_records, write_records
from needleplan.signals import Record, Role, records_of

TIME = np.linspace(0.0, 2.0, 41)


def table(**more: Any) -> pd.DataFrame:
    return pd.DataFrame({"time_s": TIME, "depth_mm": 10 * TIME, "force_n": 0.1 * TIME, **more})


def test_a_table_is_split_into_its_trials() -> None:
    names = ["a"] * 20 + ["b"] * 21
    found = records_of(table(trial=names, role=["train"] * 20 + ["holdout"] * 21, phase=["in"] * 41))
    assert [(each.trial, each.role, len(each), set(each.phase)) for each in found] == [
        ("a", Role.TRAIN, 20, {"in"}), ("b", Role.HOLDOUT, 21, {"in"}),
    ]  # fmt: skip
    assert np.array_equal(found[1]["force_n"], 0.1 * TIME[20:])


def test_tables_records_arrays_and_files_mix(tmp_path: Path) -> None:
    record = Record({"time_s": TIME, "depth_mm": 10 * TIME}, "r")
    write_records([record], tmp_path / "r.csv")
    named = np.rec.fromarrays([TIME, 5 * TIME], names="time_s,depth_mm")
    found = records_of([record, table(), {"time_s": TIME, "depth_mm": TIME}, named, tmp_path / "r.csv"], read_records)
    assert [len(each) for each in found] == [41] * 5
    assert found[3]["depth_mm"].max() == 10.0


def test_a_fit_takes_a_table() -> None:
    arc = {
        "time_s": TIME,
        "depth_mm": 10 * TIME,
        "x_mm": 100 * np.sin(TIME / 10),
        "y_mm": 100 - 100 * np.cos(TIME / 10),
    }
    found = npl.models.fit(npl.models.Bicycle(curvature_per_mm=0.02), pd.DataFrame(arc))
    assert found.model.curvature_per_mm == pytest.approx(0.01, rel=0.05)


@pytest.mark.parametrize("wrong", [3, None, np.ones((4, 3)), b"bytes", "missing.csv", [3], object()])
@pytest.mark.parametrize(
    "works", [curvature.identify, force.identify, friction.identify, tissue_motion.identify, records_of]
)
def test_other_things_are_one_clear_error(works: Any, wrong: Any) -> None:
    with pytest.raises(NeedleplanError, match=r"must be a record, a table|cannot be read|is a file"):
        works(wrong)


@pytest.mark.parametrize(
    ("more", "rule"),
    [
        ({"force_N": TIME}, "must be one of time_s"),
        ({"x_mm": ["left"] * 41}, "a column that is no numbers"),
        ({"role": ["train"] * 40 + ["holdout"]}, "must be the same in all rows of a trial"),
        ({"role": ["tests"] * 41}, "one of train, holdout"),
    ],
)
def test_wrong_columns_are_named(more: dict[str, Any], rule: str) -> None:
    with pytest.raises(DataError, match=rule):
        records_of(table(**more))
    with pytest.raises(DataError, match="must be as long as the others"):
        records_of({"time_s": TIME, "depth_mm": TIME[1:]})


def test_a_simulation_needs_a_model_and_a_motion() -> None:
    given: Any = np.ones((5, 2))
    with pytest.raises(NeedleplanError, match=r"Motion\.sampled\(time_s, depth_mm\) makes one of arrays"):
        npl.models.simulate(npl.models.Bicycle(curvature_per_mm=0.01), given)
    with pytest.raises(NeedleplanError, match="must be a model"):
        npl.models.simulate(given, given)
