"""The recordings from which a model was identified are the references of a diagnosis with it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from needleplan.diagnosis import Library, Verdict, diagnose
from needleplan.diagnosis.references import identified_from
from needleplan.models import ModelFile, Parent
from needleplan.models.effects import effect_named
from needleplan.recording import read_records, write_records
from needleplan.signals import Record, Role
from tests.diagnosis.trials import BASE, recordings

SUSPECT = recordings({"viscous": {"size": 2e-4}}, seed=2)


def identified(folder: Path, normal: Sequence[Record]) -> ModelFile:
    """Return a model file, written beside the recordings of a series in another folder, and read again."""
    (folder / "series").mkdir()
    write_records(normal, folder / "series" / "normal.csv")
    records = read_records(folder / "series" / "normal.csv")
    parents = tuple(Parent(record.trial, record.digest) for record in records)
    file = ModelFile(BASE, parents=parents).with_files(
        {records[0].digest: folder / "series" / "normal.csv"}, folder / "models"
    )
    (folder / "models").mkdir()
    file.write(folder / "models" / "model.toml")
    return ModelFile.read(folder / "models" / "model.toml")


def test_the_trials_of_an_identification_are_found_beside_its_model(tmp_path: Path) -> None:
    file = identified(tmp_path, recordings(seed=1))
    assert {parent.file for parent in file.parents} == {"../series/normal.csv"}
    found, remarks = identified_from(file, SUSPECT)
    assert [record.role for record in found] == [Role.REFERENCE] * 3  # the noise record is none
    assert [record.trial for record in found] == [f"normal.csv: trial {number}" for number in range(3)]
    assert remarks == ["references: 3 trials of ../series/normal.csv, from which the model was identified"]


def test_trials_of_two_files_with_the_same_names_are_found(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("monday.csv", "tuesday.csv")]
    for seed, path in enumerate(files):
        write_records(recordings(seed=seed), path)
    records = read_records(files)  # names that occur twice begin with that of the file
    parents = tuple(Parent(record.trial, record.digest) for record in records)
    digests = {record.digest: file for record, file in zip(records[::4], files, strict=True)}
    found, remarks = identified_from(ModelFile(BASE, parents=parents).with_files(digests, tmp_path), SUSPECT)
    assert len(found) == 6
    assert [remark[:26] for remark in remarks] == ["references: 3 trials of mo", "references: 3 trials of tu"]


def test_the_diagnosed_trials_are_no_references_of_themselves(tmp_path: Path) -> None:
    file = identified(tmp_path, recordings(seed=1))
    assert identified_from(file, read_records(tmp_path / "series" / "normal.csv")) == ([], [])


def test_given_references_are_the_only_ones(tmp_path: Path) -> None:
    file = identified(tmp_path, recordings(seed=1))
    assert identified_from(file, [*SUSPECT, replace(SUSPECT[0], role=Role.REFERENCE, trial="own")]) == ([], [])


def test_a_file_that_is_missing_or_changed_or_of_another_rate_is_named(tmp_path: Path) -> None:
    file, data = identified(tmp_path, recordings(seed=1)), tmp_path / "series" / "normal.csv"
    fast = [
        Record({**each.columns, "time_s": each["time_s"] / 2}, each.trial, each.role, digest="other")
        for each in SUSPECT
    ]
    found, remarks = identified_from(file, fast)
    assert not found
    assert "is no reference: time_s of" in remarks[0]
    data.write_bytes(data.read_bytes() + b"\n")
    assert identified_from(file, SUSPECT)[1] == [
        "../series/normal.csv, from which the model was identified, is no reference: it has changed since"
    ]
    data.unlink()
    assert identified_from(file, SUSPECT)[1][0].endswith("it is not there")


@pytest.mark.slow
def test_a_strict_diagnosis_stops_at_references_that_show_an_effect(tmp_path: Path) -> None:
    file = identified(tmp_path, recordings({"bias": {"size": 0.1}}, seed=1))
    few = Library([effect_named("bias")], BASE)
    found = diagnose(file, SUSPECT, library=few, strict=True)
    assert (found.verdict, found.names) == (Verdict.NAMED, ("bias",))
    assert all(record.trial.startswith("normal.csv") for record in found.checked.trials)
    assert any(remark.startswith("strict: the references show this alone") for remark in found.remarks)
    alone = diagnose(file, SUSPECT, library=few, references=False)
    assert not alone.checked.references
    np.testing.assert_equal(len(alone.checked.trials), 3)
