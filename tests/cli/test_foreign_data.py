"""Commands that read the text files of other laboratories by `--columns`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.diagnosis import Lack
from needleplan.diagnosis.data import check_data, sensor_noise
from needleplan.models import ModelFile
from needleplan.recording import write_records
from needleplan.reports import diagnosis as reports
from needleplan.signals import Record, Role
from tests.cli.commands import needleplan, refused
from tests.diagnosis.trials import BASE, recordings

COLUMNS = "time=t[ms],depth=-stage[m],force=-Fz[mN],velocity=v"
FACTORS = {"time_s": 1e3, "depth_mm": -1e-3, "force_n": -1e3, "velocity_mm_s": 1.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same trials as files of needleplan and as foreign files."""
    place = tmp_path_factory.mktemp("foreign")
    ModelFile(BASE).write(place / "base.toml")
    for number, record in enumerate(recordings({}, seed=1)):
        write_records([record], place / f"ours{number}.csv")
        names = [
            name for name in FACTORS if name in record.columns and (record.role is not Role.NOISE or name != "depth_mm")
        ]
        table = np.column_stack([FACTORS[name] * record[name] for name in names])
        words = {"time_s": "t", "depth_mm": "stage", "force_n": "Fz", "velocity_mm_s": "v"}
        np.savetxt(
            place / f"theirs{number}.txt", table, "%.17g", "\t", header="\t".join(words[n] for n in names), comments=""
        )
    return place


@pytest.mark.slow
def test_identify_gives_the_same_from_either_file(folder: Path) -> None:
    ours = needleplan("identify", "force", folder / "ours0.csv", "-v")
    theirs = needleplan("identify", "force", folder / "theirs0.txt", "-v", "--columns", COLUMNS)
    assert ours.returncode == theirs.returncode == 0
    assert [line for line in theirs.stdout.splitlines() if "read time_s" not in line] == ours.stdout.splitlines()
    assert "read time_s = t [ms], depth_mm = -stage [m], force_n = -Fz [mN], velocity_mm_s = v" in theirs.stderr


def test_diagnose_reads_files_and_their_roles(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[Record] = []

    def stop(_: ModelFile, records: Sequence[Record], *__: object, **___: object) -> None:
        read.extend(records)
        raise KeyboardInterrupt

    monkeypatch.setattr(reports, "diagnose_records", stop)
    files = [str(folder / f"theirs{number}.txt") for number in range(4)]
    given = [*files[:2], "--holdout", files[2], "--noise", files[3], "--columns", COLUMNS, "-o", str(folder / "out")]
    assert main(["diagnose", str(folder / "base.toml"), *given]) == 130
    assert [each.role for each in read] == [Role.TRAIN, Role.TRAIN, Role.HOLDOUT, Role.NOISE]
    for one, other in zip(read, recordings({}, seed=1), strict=True):
        np.testing.assert_allclose(one["force_n"], other["force_n"], atol=1e-12)


@pytest.mark.parametrize(("options", "expected"), [
    (["--columns", "time=t[ms],force=-Fz[mN],depth=-stag[m]"], 'did you mean "stage"?'),
    (["--columns", "time=t[ms],force=-Fz[mN],depth=-stage[um]"], "is questionably small, in metres?"),
    (["--surface", "3"], "it requires --columns"),
    (["--columns", COLUMNS, "--noise", "theirs0.txt"], "is given twice, or with two roles"),
    ([], "--columns reads files with other names"),
])  # fmt: skip
def test_wrong_options_are_refused(folder: Path, options: list[str], expected: str) -> None:
    for command in (("diagnose", "base.toml", "-o", "no"), ("identify", "force")):
        done = needleplan(*command, "theirs0.txt", *options, cwd=folder)
        assert done.returncode == 2
        assert expected in done.stderr


def test_data_that_cannot_be_diagnosed_are_refused_before_the_remarks_on_reading(folder: Path) -> None:
    rows = (folder / "theirs0.txt").read_text().splitlines()
    (folder / "gap.txt").write_text("\n".join([*rows[:300], *rows[500:]]))
    done = needleplan("diagnose", "base.toml", "gap.txt", "--columns", COLUMNS, "-o", "no", cwd=folder)
    refused(done, "time_s (gap): has a gap of ")
    assert len(done.stderr.splitlines()) == 1


def test_the_noise_is_taken_from_the_rest_before_the_entry() -> None:
    """Coloured noise: the scatter from sample to sample, which takes it for white, would be too small."""
    random = np.random.default_rng(5)
    trials = recordings({}, seed=1)
    noise = np.convolve(random.normal(0, 0.02, 2000), 0.7 ** np.arange(20), "valid")
    standing = trials[0]
    time = np.arange(500) * float(np.diff(standing["time_s"]).mean())
    columns = {
        "time_s": np.r_[time, time[-1] + time[1] + standing["time_s"] - standing["time_s"][0]],
        "depth_mm": np.r_[np.full(500, standing["depth_mm"][0]), standing["depth_mm"]],
        "velocity_mm_s": np.r_[np.zeros(500), standing["velocity_mm_s"]],
        "force_n": np.r_[noise[:500], standing["force_n"]],
    }
    checked = check_data([Record(columns, "with rest"), *trials[1:3]], BASE.channel)
    assert "s in which the needle stands before the entry" in checked.lacks[Lack.NOISE]
    found = sensor_noise(BASE, checked)
    assert found.rms == pytest.approx(float(noise.std()), rel=0.15)
    assert found.order > 0
    without = check_data(trials[:3], BASE.channel)
    assert "the scatter of the trials from sample to sample" in without.lacks[Lack.NOISE]
    assert sensor_noise(BASE, without).order == 0
    assert not check_data(trials, BASE.channel).rest
