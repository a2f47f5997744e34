"""MATLAB files of trials and tables say the same as the files they come from, also after Octave has written them."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

import needleplan as npl
from needleplan.errors import DataError
from needleplan.planning import write_mat
from needleplan.recording import Recording, parse_records, read_records, write_records
from needleplan.recording.export import FORMATS
from needleplan.signals import Record, Role
from tests.recording.samples import write_run

TIME = [0.0, 0.1, 0.2]


def octave(program: str, folder: Path) -> str:
    if not shutil.which("octave-cli"):
        assert os.environ.get("CI") != "true", "octave-cli is missing"
        pytest.skip("octave-cli is not installed")
    command = ["octave-cli", "--quiet", "--no-init-file", "--eval", program]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_trials_are_the_same_after_writing_and_reading(tmp_path: Path) -> None:
    records = [
        Record({"time_s": TIME, "force_n": [0.5, np.nan, 0.7]}, "liver µ", Role.HOLDOUT, ("in", "in", "out")),
        Record({"time_s": TIME, "force_n": [0.1, 0.2, 0.4], "depth_mm": [0.0, 1.0, 2.0]}, "second"),
    ]
    write_records(records, tmp_path / "data.mat")
    found = read_records(tmp_path / "data.mat")
    assert [(each.trial, each.role, each.phase) for each in found] == [
        (each.trial, each.role, each.phase) for each in records
    ]
    for one, other in zip(records, found, strict=True):
        assert (other.role, other.phase, {*other.columns}) == (one.role, one.phase, {*one.columns})
        for name, values in one.columns.items():
            np.testing.assert_array_equal(other[name], values)


def test_a_file_of_octave_is_read(tmp_path: Path) -> None:
    octave(
        "time_s = 0:0.1:0.3; force_n = single([1;2;3;4]); depth_mm = int16([0 1 2 3]); trial = 'gel'; mood = 'fine';"
        "save('-v7', 'data.mat', 'time_s', 'force_n', 'depth_mm', 'trial', 'mood')",
        tmp_path,
    )
    (record,) = read_records(tmp_path / "data.mat")
    assert (record.trial, record["force_n"].tolist(), record["depth_mm"].tolist()) == (
        "gel",
        [1, 2, 3, 4],
        [0, 1, 2, 3],
    )
    assert record.notes[0] == "unknown columns were left out: mood"


def test_octave_reads_an_exported_recording_and_identify_too(tmp_path: Path) -> None:
    run = Recording.read(write_run(tmp_path / "run.mcap"))
    FORMATS["mat"](run, tmp_path / "run.mat")
    (record,) = read_records(tmp_path / "run.mat")
    np.testing.assert_array_equal(record["force_n"], run.trial()["force_n"])
    assert not [each for each in record.notes if "unknown" in each]
    said = octave(
        "load run.mat; c = trial_0001.channels; n = numel(c.stage.depth_mm);"
        "printf('%d %g %s %s\\n', n, c.force.force_z_n(11), c.tracker.notes{1}, trial_0001.trial)",
        tmp_path,
    )
    assert said == "2000 -0.025 a; b run\n"


@pytest.mark.parametrize(
    ("variables", "words"),
    [
        ({"time_s": TIME, "force": TIME}, r"force: must carry its unit, N"),
        ({"time_s": TIME, "force_n": [1.0, 2.0]}, r"force_n = size \(2,\): must be a vector as long as time_s, 3"),
        ({"time_s": TIME, "force_n": np.ones((3, 2))}, r"force_n = size \(3, 2\): must be a vector"),
        ({"time_s": TIME, "force_n": "abc"}, r"force_n = .*: must hold numbers in N"),
        ({"one": {"time_s": TIME, "phase": np.array(["a", "b"], object)}}, r"one\.phase = 2 texts: must be"),
        ({"one": {"force_n": TIME}}, r"one\.time_s: is missing"),
        ({"time_s": TIME, "one": {"time_s": TIME}}, r"one: must not be beside columns"),
        ({}, r"is empty"),
    ],
)  # fmt: skip
def test_wrong_files_are_refused_with_their_place(variables: dict[str, object], words: str, tmp_path: Path) -> None:
    savemat(tmp_path / "data.mat", variables)
    with pytest.raises(DataError, match=words):
        read_records(tmp_path / "data.mat")


@pytest.mark.parametrize("length", [10, 128, 140, 200, 300])
def test_truncated_files_are_refused(length: int, tmp_path: Path) -> None:
    savemat(tmp_path / "data.mat", {"time_s": TIME, "force_n": TIME})
    with pytest.raises(DataError, match=r"damaged|empty"):
        parse_records((tmp_path / "data.mat").read_bytes()[:length])


def test_the_new_format_of_matlab_is_named() -> None:
    with pytest.raises(DataError, match=r"version 7\.3: save it with `save\(name, '-v7'\)`"):
        parse_records(b"MATLAB 7.3 MAT-file, Platform: GLNXA64" + bytes(600))


def test_octave_reads_a_table(table: npl.PolicyTable, tmp_path: Path) -> None:
    write_mat(table, tmp_path / "table.mat")
    content = loadmat(tmp_path / "table.mat")
    for name in ("values", "policy", "success"):
        np.testing.assert_array_equal(content[name], getattr(table, name))
    assert (content["digest"].item(), content["scenario"].item()) == (table.digest, table.scenario.to_toml())
    at = octave("load table.mat; printf('%.9g %d %g', success(11, 21, 1, 2), columns(policy), spacing_mm(2))", tmp_path)
    assert at.split() == [f"{table.success[10, 20, 0, 1]:.9g}", "41", "1"]
