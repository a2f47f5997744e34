"""What a caller may give to `diagnose`: models, files, tables, and the message for anything else."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from needleplan.diagnosis import Library, diagnose
from needleplan.errors import DataError, NeedleplanError
from needleplan.models import ModelFile
from needleplan.models.effects import effect_named
from needleplan.recording import write_records
from tests.diagnosis.trials import BASE, recordings


def _given(folder: Path) -> tuple[Path, list[Any]]:
    """Return the path of a model, and four recordings: two in a file, one in a DataFrame, one as a mapping."""
    pandas = pytest.importorskip("pandas")
    records = recordings({"viscous": {"size": 1e-4}})
    ModelFile(BASE).write(folder / "model.toml")
    write_records(records[:2], folder / "first.csv")
    third, still = ({**each.columns, "trial": [each.trial] * len(each)} for each in records[2:])
    frame = pandas.DataFrame(third).assign(role="holdout")
    return folder / "model.toml", [folder / "first.csv", frame, {**still, "role": ["noise"] * len(still["trial"])}]


def test_files_and_tables_are_read(tmp_path: Path) -> None:
    model, given = _given(tmp_path)
    with pytest.raises(DataError) as raised:
        diagnose(model, given[1:])
    assert str(raised.value) == "diagnose: role: no trial has the role train: there is nothing to diagnose"
    shallow = {"time_s": np.arange(300) / 50, "depth_mm": np.linspace(0, 1, 300), "force_n": np.linspace(0, 1, 300)}
    with pytest.raises(DataError, match=r"shallow.*must reach"):
        diagnose(model, [*given, {**shallow, "trial": ["shallow"] * 300}])


@pytest.mark.slow
def test_files_and_tables_give_the_answer_of_their_records(tmp_path: Path) -> None:
    few = Library([effect_named(name) for name in ("viscous", "bias")], BASE)
    model, given = _given(tmp_path)
    records = recordings({"viscous": {"size": 1e-4}})
    expected, found = diagnose(BASE, records, library=few), diagnose(model, given, library=few)
    assert [(each.trial, each.role) for each in found.recordings] == [(each.trial, each.role) for each in records]
    assert found.names == expected.names == ("viscous",)
    assert found.effects[0].values == pytest.approx(expected.effects[0].values, rel=1e-3)


@pytest.mark.parametrize(
    ("model", "given", "options", "message"),
    [
        (3, 4, {}, "model = <int>: must be a model of needleplan.models, a ModelFile, or the path of a model file"),
        (type(BASE), [], {}, "model = <ABCMeta>: must be a model"),
        ("no.toml", [], {}, "no.toml: cannot be read: No such file"),
        (BASE, 4, {}, "records = <int>: must be a record, a table of columns such as a DataFrame"),
        (BASE, [4], {}, "records = <int>: must be a record"),
        (BASE, np.zeros(3), {}, "records = <ndarray>: must be a record"),
        (BASE, "no.csv", {}, "no.csv: cannot be read: No such file"),
        (BASE, [], {}, "diagnose: role: no trial has the role train"),
        (BASE, [], {"library": ["viscous"]}, "diagnose: library = <list>: must be a Library of needleplan.diagnosis"),
        (BASE, [], {"settings": 0.9}, "diagnose: settings = <float>: must be a Settings of needleplan.diagnosis"),
        (BASE, [], {"progress": 3}, "diagnose: progress = 3: must be a function of a text, True for a bar, or None"),
    ],
)
def test_anything_else_is_refused_with_one_message(
    model: Any, given: Any, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(NeedleplanError, match=re.escape(message)):
        diagnose(model, given, **options)
