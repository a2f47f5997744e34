"""A table that was changed and sealed again is refused; a signature finds what corrected digests hide."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

import needleplan as npl
from needleplan.artifacts import digest, hdf5_guard
from needleplan.errors import ChecksumError, TableError
from needleplan.planning import _sealed_file, is_signed
from needleplan.planning._seal import seal
from tests.cli.commands import needleplan, refused

CRASHING = "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"


def test_a_table_at_which_the_library_crashes_is_refused_by_the_program_and_not_its_end(
    table_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such a table is one in 2,000 of those with one altered byte and a new seal; where depends on the library."""
    whole = npl.PolicyTable.read(table_file, isolated=True)
    assert whole.digest == npl.PolicyTable.read(table_file).digest
    child = tmp_path / "child.py"
    child.write_text(CRASHING)
    monkeypatch.setattr(hdf5_guard, "_CHILD", child)
    with pytest.raises(TableError, match=r"\.h5: is damaged: libhdf5 crashed when reading it"):
        npl.PolicyTable.read(table_file, isolated=True)
    _sealed_file._harmless.clear()
    refused(needleplan("info", table_file), "libhdf5 crashed")


class Tries:
    """Counts the tables that a child process tries."""

    def __init__(self) -> None:
        self.paths: list[Path] = []

    def __call__(self, path: Path) -> None:
        self.paths.append(path)


@pytest.fixture
def tries(monkeypatch: pytest.MonkeyPatch) -> Tries:
    found = Tries()
    monkeypatch.setattr(hdf5_guard, "require_harmless", found)
    monkeypatch.setattr(_sealed_file, "_harmless", set())
    return found


def test_a_table_from_elsewhere_is_tried_in_a_child_process_once(
    table_file: Path, tries: Tries, tmp_path: Path
) -> None:
    npl.PolicyTable.read(table_file)
    assert tries.paths == [table_file]
    npl.PolicyTable.read(table_file)
    (tmp_path / "copy.h5").write_bytes(table_file.read_bytes())
    npl.PolicyTable.read(tmp_path / "copy.h5")
    assert tries.paths == [table_file]
    npl.PolicyTable.read(table_file, isolated=True)
    assert tries.paths == [table_file, table_file]
    resealed(tmp_path / "copy.h5", lambda file: file.attrs.__setitem__("title", "another"))
    npl.PolicyTable.read(tmp_path / "copy.h5", isolated=False)
    assert len(tries.paths) == 2
    npl.PolicyTable.read(tmp_path / "copy.h5")
    assert tries.paths[2:] == [tmp_path / "copy.h5"]


def test_a_table_that_is_signed_or_from_this_process_needs_no_child_process(
    table_file: Path, tries: Tries, tmp_path: Path
) -> None:
    key = b"k" * 32
    table = npl.PolicyTable.read(table_file, isolated=False)
    table.write(tmp_path / "signed.h5", sign_key=key)
    npl.PolicyTable.read(tmp_path / "signed.h5")
    _sealed_file._harmless.clear()
    npl.PolicyTable.read(tmp_path / "signed.h5", verify_key=key)
    assert tries.paths == []
    with pytest.raises(ChecksumError):
        npl.PolicyTable.read(tmp_path / "signed.h5", verify_key=b"q" * 32)
    npl.PolicyTable.read(tmp_path / "signed.h5")
    assert tries.paths == [tmp_path / "signed.h5"]


def test_a_table_at_which_the_library_crashes_does_not_end_a_python_program(
    table_file: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(_sealed_file, "_harmless", set())
    child = tmp_path / "child.py"
    child.write_text(CRASHING)
    monkeypatch.setattr(hdf5_guard, "_CHILD", child)
    for _ in range(2):
        with pytest.raises(TableError, match="libhdf5 crashed"):
            npl.PolicyTable.read(table_file)


def flipped(data: bytes, place: int, bit: int) -> bytes:
    altered = bytearray(data)
    altered[place] ^= 1 << bit
    return bytes(altered)


def resealed(path: Path, change: Callable[[h5py.File], None]) -> None:
    with h5py.File(path, "r+") as file:
        change(file)
    data = path.read_bytes()
    path.write_bytes(seal(memoryview(data)[512:]) + data[512:])


@pytest.mark.parametrize(
    "change",
    [
        lambda file: file.__delitem__("values"),
        lambda file: file.attrs.__delitem__("scenario"),
        lambda file: file.attrs.__setitem__("scenario", "nonsense"),
        lambda file: file.attrs.__setitem__("scenario", 3),
        lambda file: file.attrs.__setitem__("status", "happy"),
        lambda file: file.attrs.__delitem__("backups"),
        lambda file: (file.__delitem__("policy"), file.__setitem__("policy", np.zeros(3, np.uint8))),
    ],
)
def test_a_sealed_file_that_is_no_table_is_refused(
    table_file: Path, tmp_path: Path, change: Callable[[h5py.File], None]
) -> None:
    path = tmp_path / "odd.h5"
    path.write_bytes(table_file.read_bytes())
    resealed(path, change)
    with pytest.raises(TableError, match=r"odd\.h5"):
        npl.PolicyTable.read(path)


def replaced(name: str, change: Callable[[np.ndarray], object]) -> Callable[[h5py.File], None]:
    """Return a change that replaces a dataset and keeps its attributes; its SHA-256 is made to agree."""

    def replace_it(file: h5py.File) -> None:
        attributes, data = dict(file[name].attrs), np.asarray(change(file[name][()]))
        del file[name]
        file[name] = data
        file[name].attrs.update(attributes | {"sha256": digest(data.data)})

    return replace_it


def stored_otherwise(make: Callable[[h5py.File, tuple[int, ...], str], object]) -> Callable[[h5py.File], None]:
    """Return a change that keeps the attributes of the values, and stores them in another way."""

    def store_it(file: h5py.File) -> None:
        attributes, shape = dict(file["values"].attrs), file["values"].shape
        del file["values"]
        make(file, shape, file.filename)
        if isinstance(file.get("values", getlink=True), h5py.HardLink):
            file["values"].attrs.update(attributes)

    return store_it


def moved(scenario: str) -> str:
    assert "[50.0, 25.0]" in scenario
    return scenario.replace("[50.0, 25.0]", "[50.0, 26.0]")


def virtual(file: h5py.File, shape: tuple[int, ...], source: str) -> None:
    layout = h5py.VirtualLayout(shape, "f4")
    layout[:] = h5py.VirtualSource(source, "values", shape)
    file.create_virtual_dataset("values", layout)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (replaced("policy", lambda policy: 1 - policy), "table: its SHA-256 is not the stored one"),
        (replaced("policy", lambda policy: policy + np.uint8(255)), "table: its SHA-256"),
        (replaced("success", lambda success: success * 0 + 1), "table: its SHA-256"),
        (lambda file: file["policy"].__setitem__((0, 0, 0, 0), 1 - file["policy"][0, 0, 0, 0]), "policy: its SHA-256"),
        (lambda file: file.attrs.__setitem__("scenario", moved(file.attrs["scenario"])),
         "scenario: its SHA-256"),
        (lambda file: file.attrs.__setitem__("digest", "sha256:0"), "table: its SHA-256"),
        (lambda file: file["x_mm"].__setitem__(3, 7.5), "x_mm: must hold the axis of the scenario, from 0 to 60"),
        (lambda file: file.attrs.__setitem__("spacing_mm", (2.0, 2.0)), "spacing_mm"),
        (lambda file: file.attrs.__setitem__("residual", np.nan), "residual = nan: must be a number"),
        (stored_otherwise(lambda file, _, __: file.create_group("values")), "values: must be a dataset of the file"),
        (stored_otherwise(lambda file, _, __: file.__setitem__("values", h5py.SoftLink("/values"))),
         "values: must be a dataset of the file, not a link"),
        (stored_otherwise(lambda file, _, name: file.__setitem__("values", h5py.ExternalLink(name, "/policy"))),
         "values: must be a dataset of the file, not a link"),
        (stored_otherwise(virtual), "values: must be stored in the file itself"),
        (stored_otherwise(lambda file, shape, _: file.create_dataset(
            "values", shape, "f4", external=[("/etc/services", 0, 10**6)])), "values: must be stored in the file"),
        (stored_otherwise(lambda file, shape, _: file.create_dataset("values", shape, "f4", chunks=True)),
         "stored in the file itself: its data are not there"),
        (stored_otherwise(lambda file, shape, _: file.create_dataset(
            "values", data=np.zeros(shape, "f4"), compression="lzf")), "must be compressed by shuffle and gzip only"),
        (stored_otherwise(lambda file, _, __: file.__delitem__("x_mm") or file.create_dataset(
            "x_mm", 61, "f8", chunks=True)),
         "x_mm: must be stored in the file itself, in one piece"),
        (stored_otherwise(lambda file, shape, _: file.create_dataset("values", shape, "f4")), "its data are not there"),
        (stored_otherwise(lambda file, _, __: file.create_dataset("values", (10**6, 10**6, 60, 2), "f4")),
         "must have the shape"),
        (stored_otherwise(lambda file, shape, _: file.create_dataset("values", data=np.zeros(shape, "f8"))),
         "values: its SHA-256"),
    ],
)  # fmt: skip
def test_what_was_changed_and_sealed_again_is_found(
    change: Callable[[h5py.File], None], says: str, table_file: Path, tmp_path: Path
) -> None:
    path = tmp_path / "odd.h5"
    path.write_bytes(table_file.read_bytes())
    resealed(path, change)
    with pytest.raises(TableError) as refused:
        npl.PolicyTable.read(path)
    assert says in str(refused.value)
    assert str(refused.value).startswith(f"{path}: ")


def consistent(name: str, number: float) -> Callable[[h5py.File], None]:
    """Return a change of one number of a table that also corrects all digests."""

    def change(file: h5py.File) -> None:
        file[name][0, 0, 0, 0] = number
        arrays = [digest(file[each][()].data) for each in ("values", "policy", "success")]
        file[name].attrs["sha256"] = digest(file[name][()].data)
        file.attrs["digest"] = digest("\n".join([file.attrs["scenario_digest"], *arrays]))

    return change


@pytest.mark.parametrize(
    ("name", "number", "says"),
    [
        ("policy", 255, "policy = 255: must be 0 (insert) or 1"),
        ("success", 7, "success = 0 to 7: must be probabilities"),
        ("success", -0.1, "must be probabilities"),
        ("success", np.nan, "must be probabilities"),
        ("values", np.nan, "values = nan: must be costs"),
    ],
)
def test_numbers_that_no_table_holds_are_refused_with_every_digest_right(
    name: str, number: float, says: str, table_file: Path, tmp_path: Path
) -> None:
    path = tmp_path / "odd.h5"
    path.write_bytes(table_file.read_bytes())
    resealed(path, consistent(name, number))
    with pytest.raises(TableError) as refused:
        npl.PolicyTable.read(path)
    assert says in str(refused.value)


KEY = b"a secret of the laboratory"


def test_a_signature_finds_what_a_new_seal_hides(table: npl.PolicyTable, tmp_path: Path) -> None:
    signed, plain = tmp_path / "signed.h5", tmp_path / "plain.h5"
    table.write(signed, sign_key=KEY)
    table.write(plain)
    assert (is_signed(signed), is_signed(plain)) == (True, False)
    for path, key in ((signed, KEY), (signed, None), (plain, None)):
        assert npl.PolicyTable.read(path, verify_key=key).digest == table.digest
    with pytest.raises(ChecksumError, match=r"plain\.h5: is not signed"):
        npl.PolicyTable.read(plain, verify_key=KEY)
    with pytest.raises(ChecksumError, match="is signed with another key, or has been altered"):
        npl.PolicyTable.read(signed, verify_key=KEY + b"!")
    with pytest.raises(npl.InputError, match="key = 3 bytes: must have at least 16 bytes"):
        table.write(signed, sign_key=b"abc", force=True)
    # One number, changed with all digests and the seal, is read without a key and refused with it.
    data = signed.read_bytes()
    value = table.values[1, 1, 1, 1]
    resealed(signed, consistent("values", float(value) + 1))
    assert npl.PolicyTable.read(signed).digest != table.digest
    with pytest.raises(ChecksumError, match="is not signed"):
        npl.PolicyTable.read(signed, verify_key=KEY)
    body = signed.read_bytes()[512:]
    signature = data[:512].split(b"\n")[1] + b"\n"
    kept = (seal(memoryview(body)).rstrip(b"\0") + signature).ljust(512, b"\0")
    signed.write_bytes(kept + body)
    with pytest.raises(ChecksumError, match="is signed with another key, or has been altered and sealed again"):
        npl.PolicyTable.read(signed, verify_key=KEY)


@pytest.mark.slow
def test_every_flipped_bit_of_a_signed_seal_is_found(table: npl.PolicyTable, tmp_path: Path) -> None:
    path = tmp_path / "signed.h5"
    table.write(path, sign_key=KEY)
    data = path.read_bytes()
    for place in range(512):
        path.write_bytes(flipped(data, place, place % 8))
        with pytest.raises(TableError):
            npl.PolicyTable.read(path, verify_key=KEY)
