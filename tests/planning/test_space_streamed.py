"""3D tables that are written while they are solved and mapped into memory."""

import errno
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
from collections import namedtuple
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from needleplan.anatomy import SpaceScenario
from needleplan.errors import ChecksumError, OutputError, TableError
from needleplan.planning import (
    SpaceTable,
    _space_places,
    entries_vtp,
    entry_map,
    markups_text,
    plan_space,
    success_bytes,
)
from needleplan.planning._sealed_file import SealedBytes
from tests.anatomy.volumes import TEXT, anatomy, box, write
from tests.cli.commands import needleplan

pytestmark = pytest.mark.usefixtures("few_executions")

# Size (bytes) of the files that this test lets be written: less than a table, more than its grid.
SMALL = 200_000


@cache
def scenario(spacing: float = 2.0) -> SpaceScenario:
    return SpaceScenario.of(anatomy(box(), TEXT.replace("spacing_mm = 4.0", f"spacing_mm = {spacing}")))


@cache
def in_memory() -> SpaceTable:
    return plan_space(scenario(), streamed=False, threads=1)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("streamed") / "table.h5"
    plan_space(scenario(), file=path, streamed=True, threads=2)
    return path


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Within the context, files cannot grow beyond a size, as on a full disk. Python compiles no module, or cuts it."""
    before, compiled = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = compiled


def is_mapped(table: SpaceTable) -> bool:
    return all(
        isinstance(getattr(table.solved, name).base, np.memmap) and not getattr(table.solved, name).flags.writeable
        for name in ("values", "policy", "success")
    )


def test_a_streamed_file_is_that_of_a_table_in_memory(file: Path, tmp_path: Path) -> None:
    in_memory().best_entry()
    in_memory().write(tmp_path / "table.h5")
    with h5py.File(file) as one, h5py.File(tmp_path / "table.h5") as other:
        assert set(one) == set(other)
        assert all(np.array_equal(one[name], other[name]) for name in one)
        for name in one:
            assert set(one[name].attrs) == set(other[name].attrs)
            assert all(np.array_equal(one[name].attrs[key], other[name].attrs[key]) for key in one[name].attrs)
        texts = ("format", "scenario", "scenario_digest", "digest", "status", "axes", "made_by", "title")
        assert [one.attrs[name] for name in texts] == [other.attrs[name] for name in texts]
        assert set(one.attrs) == set(other.attrs)
    assert [each.name for each in file.parent.iterdir()] == ["table.h5"]


@pytest.mark.slow
def test_mapped_tables_answer_as_those_in_memory(file: Path) -> None:
    table, temporary = in_memory(), plan_space(scenario(), streamed=True, threads=1)
    assert not is_mapped(table)
    wanted, start = entry_map(table), table.best_entry()
    poses = np.ascontiguousarray(wanted.poses[::3])
    answers, runs = table.solved.look_up(poses), table.rollout(start, 200, seed=4)
    for other in (SpaceTable.read(file, mapped=True), temporary):
        assert is_mapped(other)
        assert other.digest == table.digest
        assert other.best_entry() == start
        again = other.solved.look_up(poses)
        assert all(np.array_equal(again[name], answers[name]) for name in answers)
        assert other.rollout(start, 200, seed=4) == runs
        assert np.array_equal(other.path(start).poses, table.path(start).poses)
        ranked = entry_map(other)
        best = ranked.best(3)
        assert best == wanted.best(3)
        assert [ranked.entry(each) for each in best] == [wanted.entry(each) for each in best]
        assert success_bytes(ranked) == success_bytes(wanted)
        assert entries_vtp(ranked, best) == entries_vtp(wanted, best)
        assert markups_text(ranked, best) == markups_text(wanted, best)


def test_a_mapped_table_is_written_again_and_outlives_its_file(file: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.h5"
    copy.write_bytes(file.read_bytes())
    table = SpaceTable.read(copy, mapped=True)
    table.write(copy, force=True)
    table.write(tmp_path / "small.h5", compressed=True)
    copy.unlink()
    assert SpaceTable.read(tmp_path / "small.h5", mapped=True).digest == in_memory().digest
    assert table.lookup(table.best_entry()) == in_memory().lookup(in_memory().best_entry())


def test_tables_beyond_half_of_the_memory_are_streamed_and_mapped(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    needed = 7 * in_memory().stats.states
    for available, expected in ((2 * needed + 100_000, False), (2 * needed - 2, True)):
        monkeypatch.setattr(_space_places, "_available_bytes", lambda available=available: available)
        path = tmp_path / f"{available}.h5"
        assert is_mapped(plan_space(scenario(), file=path, threads=1)) == expected
        assert is_mapped(plan_space(scenario(), threads=1)) == expected
        monkeypatch.setattr(_space_places, "_available_bytes", lambda expected=expected: 0 if expected else 1e12)
        assert is_mapped(SpaceTable.read(path)) == expected


@pytest.mark.parametrize("place", [512, 513])
def test_data_that_are_not_aligned_are_loaded(tmp_path: Path, place: int) -> None:
    numbers = np.arange(7, dtype=np.uint16)
    (tmp_path / "data").write_bytes(b"\0" * place + numbers.tobytes())

    class Stored:
        """A dataset of a foreign file."""

        chunks, dtype, shape = None, numbers.dtype, numbers.shape
        id = SimpleNamespace(get_offset=lambda: place)

        def __getitem__(self, _: object) -> np.ndarray:
            return numbers

    with (tmp_path / "data").open("rb") as stream:
        found = SealedBytes(stream, place + 14).array(Stored(), numbers.dtype)
    assert isinstance(found.base, np.memmap) == (place % 2 == 0)
    assert np.array_equal(found, numbers)
    assert not found.flags.writeable


@pytest.mark.parametrize("place", [600, 0.5, -5])
def test_a_flipped_bit_is_noticed_without_loading_the_file(file: Path, tmp_path: Path, place: float) -> None:
    data = bytearray(file.read_bytes())
    data[int(place * len(data)) if isinstance(place, float) else place] ^= 1
    (tmp_path / "flipped.h5").write_bytes(data)
    with pytest.raises(ChecksumError, match="SHA-256"):
        SpaceTable.read(tmp_path / "flipped.h5", mapped=True)
    (tmp_path / "short.h5").write_bytes(data[:-1000])
    with pytest.raises(TableError, match="truncated"):
        SpaceTable.read(tmp_path / "short.h5", mapped=True)


def test_a_signed_table_is_streamed_and_verified(tmp_path: Path) -> None:
    path, key = tmp_path / "signed.h5", b"a secret of sixteen bytes"
    plan_space(scenario(), file=path, sign_key=key, streamed=True, threads=1)
    assert is_mapped(SpaceTable.read(path, verify_key=key, mapped=True))
    with pytest.raises(ChecksumError, match="another key"):
        SpaceTable.read(path, verify_key=b"a different sixteen bytes", mapped=True)


@pytest.mark.parametrize("size", [1_000, 20_000, SMALL])
@pytest.mark.parametrize("reserves", [True, False])
def test_a_full_disk_is_one_error_and_leaves_the_old_table(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int, reserves: bool
) -> None:
    if not reserves:
        monkeypatch.setattr(os, "posix_fallocate", refused)
    path = tmp_path / "table.h5"
    path.write_bytes(file.read_bytes())
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for target, streamed in ((path, True), (path, False), (None, True)):
        with largest_file(size), pytest.raises(OutputError, match=r"cannot be written: .*File too large"):
            plan_space(scenario(), file=target, streamed=streamed, threads=1)
    assert [each.name for each in tmp_path.iterdir()] == ["table.h5"]
    assert path.read_bytes() == file.read_bytes()


def refused(*_: object) -> None:
    """Fail like a file system that cannot reserve room."""
    raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))


def test_a_disk_without_room_is_known_before_the_solve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")(10**9, 10**9 - 10**6, 10**6)
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage)
    for path in (tmp_path / "table.h5", None):
        with pytest.raises(OutputError, match=r"needs 0.00 GB, and the disk has 0.00 GB left"):
            plan_space(scenario(), file=path, streamed=True, threads=1)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", [KeyboardInterrupt, StopIteration])
def test_a_solve_that_is_interrupted_leaves_the_old_table(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: type[BaseException]
) -> None:
    path = tmp_path / "table.h5"
    path.write_bytes(file.read_bytes())
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def interrupt(*_: float) -> None:
        raise ending

    fine = scenario(0.5)  # a solve takes longer than it takes until the progress is first asked for
    expected = KeyboardInterrupt if ending is KeyboardInterrupt else OutputError
    for target, streamed in ((path, True), (path, False), (None, True)):
        with pytest.raises(expected, match=None if ending is KeyboardInterrupt else "status interrupted"):
            plan_space(fine, file=target, streamed=streamed, threads=1, progress=interrupt)
    assert [each.name for each in tmp_path.iterdir()] == ["table.h5"]
    assert path.read_bytes() == file.read_bytes()


@pytest.mark.slow
def test_the_command_streams_and_says_so_if_it_cannot(tmp_path: Path) -> None:
    scene, table = write(tmp_path, box()), tmp_path / "table.h5"
    assert needleplan("plan", scene, "-o", table, "--stream", "--json").returncode == 0
    before = table.read_bytes()
    with largest_file(50_000):
        done = needleplan("plan", scene, "-o", table, "--stream", "--force")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "File too large" in done.stderr
    assert table.read_bytes() == before
    assert needleplan("info", table).returncode == 0
    assert not list(tmp_path.glob(".*"))
    without = needleplan("plan", scene, "--stream", "--json")
    assert without.returncode == 0, without.stderr
    assert json.loads(without.stdout)["digest"] == SpaceTable.read(table).digest
    assert {each.name for each in tmp_path.iterdir()} == {"anatomy.toml", "box.nii.gz", "labels.ctbl", "table.h5"}
    assert "anatomy" in needleplan("plan", "four_obstacles", "-o", tmp_path / "plane.h5", "--stream").stderr


def ctrl_c() -> None:
    """Let SIGINT end the process, which a shell may have made its children ignore."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.mark.slow
def test_an_interrupted_command_leaves_no_file(tmp_path: Path) -> None:
    scene = write(tmp_path, box(), TEXT.replace("spacing_mm = 4.0", "spacing_mm = 0.5").replace("= 8.0\nr", "= 4.0\nr"))
    command = [sys.executable, "-m", "needleplan", "plan", scene, "-o", tmp_path / "table.h5", "--stream"]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, preexec_fn=ctrl_c
    ) as running:
        while not list(tmp_path.glob(".*.partial")):
            assert running.poll() is None, "ended before it could be interrupted"
        running.send_signal(signal.SIGINT)
        _, errors = running.communicate(timeout=60)
    assert (running.returncode, errors.strip()) == (130, "needleplan: interrupted")
    assert not list(tmp_path.glob(".*"))
    assert not (tmp_path / "table.h5").exists()
