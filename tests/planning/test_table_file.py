"""A table survives its file bit for bit, and an altered file is always refused."""

import errno
import io
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import needleplan as npl
from needleplan.artifacts import files as provenance
from needleplan.errors import ChecksumError, OutputError, TableError
from needleplan.planning import TABLE_FORMAT as FORMAT
from needleplan.planning import Stats, Status
from needleplan.scenario import Grid, Scenario, Transition
from tests.scenario.scenes import scenarios


def test_a_table_comes_back_bit_for_bit(table: npl.PolicyTable, table_file: Path) -> None:
    again = npl.PolicyTable.read(table_file)
    for name in ("values", "policy", "success"):
        written, read = getattr(table, name), getattr(again, name)
        assert written.tobytes() == read.tobytes()
        assert written.dtype == read.dtype
    assert (again.stats, again.scenario, again.digest) == (table.stats, table.scenario, table.digest)


@settings(max_examples=25, deadline=None)
@given(scenarios(), st.data())
def test_any_scenario_and_any_numbers_come_back(
    tmp_path_factory: pytest.TempPathFactory, scenario: Scenario, data: st.DataObject
) -> None:
    random = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    values = random.integers(0, 2**32, scenario.shape, dtype=np.uint32).view(np.float32)
    values[np.isnan(values)] = np.inf  # no cost is NaN
    policy = random.integers(0, 2, scenario.shape, dtype=np.uint8)
    success = random.random(scenario.shape, dtype=np.float32)
    numbers = st.floats(allow_nan=False)
    stats = Stats(
        scenario.states, 24, data.draw(st.integers(0, 2**62)), data.draw(st.integers(0, 2**62)), data.draw(numbers),
        data.draw(numbers), data.draw(numbers), data.draw(st.sampled_from(Status)), 1.0, 0.5, 0.25,
        tuple(data.draw(st.lists(st.integers(0, 2**32 - 1), max_size=30))),
    )  # fmt: skip
    path = tmp_path_factory.mktemp("any") / "table.h5"
    npl.PolicyTable(values, policy, success, stats, scenario).write(path)
    again = npl.PolicyTable.read(path)
    assert again.values.tobytes() == values.tobytes()
    assert again.policy.tobytes() == policy.tobytes()
    assert again.success.tobytes() == success.tobytes()
    assert (again.stats, again.scenario) == (stats, scenario)


def test_any_other_program_can_read_it(table: npl.PolicyTable, table_file: Path) -> None:
    with h5py.File(table_file, "r") as file:
        np.testing.assert_array_equal(file["values"], table.values)
        assert all(file[name].chunks is None and file[name].compression is None for name in file)
        assert file["x_mm"][()].tolist() == table.scenario.x_mm.tolist()
        assert file["heading_rad"].attrs["units"] == "rad"
        assert file["bevel"][()].tolist() == [-1, 1]
        assert file["success"].attrs["sha256"] == provenance.digest(table.success.tobytes())
        assert file.attrs["scenario_digest"] == table.scenario.digest
        assert file.attrs["digest"] == table.digest
        assert Scenario.from_toml(file.attrs["scenario"]) == table.scenario


@pytest.fixture(scope="module")
def tiny_file(small: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tiny") / "tiny.h5"
    npl.plan(replace(small, grid=Grid((5, 5), Transition.INTERPOLATED))).write(path)
    return path


def flipped(data: bytes, place: int, bit: int) -> bytes:
    altered = bytearray(data)
    altered[place] ^= 1 << bit
    return bytes(altered)


def test_every_flipped_bit_is_found(tiny_file: Path, tmp_path: Path) -> None:
    data = tiny_file.read_bytes()
    random = np.random.default_rng(0)
    places = [*range(600), *range(600, len(data), 97), *range(len(data) - 100, len(data))]
    path = tmp_path / "flipped.h5"
    for place in places:
        path.write_bytes(flipped(data, place, int(random.integers(8))))
        with pytest.raises(
            TableError, match=r"flipped.h5: (has been altered|is not a policy table|format|is truncated)"
        ):
            npl.PolicyTable.read(path)


def test_a_flipped_bit_behind_the_seal_is_a_wrong_checksum(table_file: Path, tmp_path: Path) -> None:
    data = table_file.read_bytes()
    (tmp_path / "t.h5").write_bytes(flipped(data, len(data) // 2, 3))
    with pytest.raises(ChecksumError, match="has been altered since it was written"):
        npl.PolicyTable.read(tmp_path / "t.h5")


def test_every_truncation_is_found(tiny_file: Path, tmp_path: Path) -> None:
    data = tiny_file.read_bytes()
    path = tmp_path / "short.h5"
    for length in [*range(0, 700, 7), *range(700, len(data), len(data) // 50), len(data) - 1]:
        path.write_bytes(data[:length])
        with pytest.raises(TableError, match=r"is truncated|is not a policy table"):
            npl.PolicyTable.read(path)
    path.write_bytes(data + b"\0")
    with pytest.raises(ChecksumError):
        npl.PolicyTable.read(path)


def test_a_change_by_another_program_is_found(table_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "edited.h5"
    path.write_bytes(table_file.read_bytes())
    with h5py.File(path, "r+") as file:
        file["values"][0, 0, 0, 0] = -1
    with pytest.raises(ChecksumError):
        npl.PolicyTable.read(path)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "is not a policy table"),
        (b"x,y\n1,2\n", "is not a policy table"),
        (b"needleplan.table/2 10 bytes sha256:00\n", "format = needleplan.table/2: another version"),
        (b"needleplan.table/1\n", "is not a policy table"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "is an HDF5 file, but not a sealed policy table"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes, expected: str) -> None:
    (tmp_path / "file").write_bytes(content)
    with pytest.raises(TableError, match=expected):
        npl.PolicyTable.read(tmp_path / "file")


def test_missing_files_and_folders_are_told(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="cannot be read: No such file or directory"):
        npl.PolicyTable.read(tmp_path / "missing.h5")
    with pytest.raises(TableError, match="cannot be read: Is a directory"):
        npl.PolicyTable.read(tmp_path)


def test_a_full_disk_leaves_nothing_behind(
    table: npl.PolicyTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(provenance.os, "fsync", full)
    with pytest.raises(OutputError, match="No space left on device"):
        table.write(tmp_path / "table.h5")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(OutputError, match="No space left on device"):
        table.write("/dev/full")


WRITE_LIMITED = """
import resource, signal, sys
import needleplan as npl
table = npl.PolicyTable.read(sys.argv[1])
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
try:
    table.write(sys.argv[2], force=True)
except npl.InputError as error:
    print(error)
"""


def test_a_limit_of_the_file_size_leaves_the_old_table(table_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "table.h5"
    path.write_bytes(b"old")
    done = subprocess.run(
        [sys.executable, "-B", "-c", WRITE_LIMITED, str(table_file), str(path)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"{path}: cannot be written: File too large\n"
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_existing_file_is_overwritten_by_force_only(table: npl.PolicyTable, tmp_path: Path) -> None:
    path = tmp_path / "table.h5"
    path.write_bytes(b"old")
    with pytest.raises(OutputError, match="exists already; force=True overwrites it"):
        table.write(path)
    assert path.read_bytes() == b"old"
    table.write(path, force=True)
    assert npl.Table.read(path).digest == table.digest


def test_the_format_is_named_in_the_first_bytes(table_file: Path) -> None:
    assert table_file.read_bytes().startswith(FORMAT.encode())


def test_a_table_in_other_units_is_refused(tiny_file: Path, tmp_path: Path) -> None:
    """Another program may write a whole and sealed file; it must not be taken for one in mm."""
    image = io.BytesIO(tiny_file.read_bytes())
    with h5py.File(image, "r+") as file:
        file["x_mm"].attrs["units"] = "inch"
        file["heading_rad"].attrs["units"] = "deg"
    body = image.getvalue()[512:]
    seal = f"{FORMAT} {len(body)} bytes {provenance.digest(body)}\n".encode().ljust(512, b"\0")
    (tmp_path / "inch.h5").write_bytes(seal + body)
    with pytest.raises(TableError, match=r'x_mm\.units = inch: must be "mm"') as refused:
        npl.PolicyTable.read(tmp_path / "inch.h5")
    assert 'heading_rad.units = deg: must be "rad"' in str(refused.value)
