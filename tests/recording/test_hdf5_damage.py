"""A damaged HDF5 file is read or refused in a bounded time; libhdf5 itself may hang or crash on it."""

import io
import json
import os
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import monotonic

import h5py
import numpy as np
import pytest

from needleplan.artifacts import hdf5_guard
from needleplan.errors import DataError
from needleplan.recording import parse_records, read_records
from tests.cli.commands import needleplan, refused

SMALL = Path(__file__).with_name("small.hdf5")  # two columns and the phases of nine samples
HANGS, CRASHES = (2048, 199), (1881, 24)  # place and flipped bits

# Reads damaged copies of a file, each in a forked process with the limits of the child, and prints the number of files
# by result, and the damages that end the process.
FUZZ = """
import json, os, random, sys, types
import h5py
from needleplan.errors import DataError
from needleplan.artifacts import _hdf5_child as child, hdf5_guard
from needleplan.recording import parse_records
class Done:
    returncode = 0
def in_process(command, input, **_):
    Done.stdout = child.main(command[5:], input)
    return Done
hdf5_guard.subprocess = types.SimpleNamespace(run=in_process, PIPE=0, DEVNULL=0, TimeoutExpired=TimeoutError)
whole = open(sys.argv[1], "rb").read()
results, ended, seed, files = {}, [], int(sys.argv[2]), int(sys.argv[3])
chance = random.Random(seed)
for _ in range(files):
    place, bits = chance.randrange(len(whole)), chance.randrange(1, 256)
    content = bytearray(whole)
    content[place] ^= bits
    process = os.fork()
    if not process:
        child.limit(1, 2**32)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        try:
            parse_records(bytes(content), accept_units=True)
            os._exit(0)
        except DataError:
            os._exit(1)
        except BaseException:
            os._exit(9)
    status = os.waitpid(process, 0)[1]
    result = f"signal {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else ("read", "refused")[os.WEXITSTATUS(status)]
    results[result] = results.get(result, 0) + 1
    if os.WIFSIGNALED(status):
        ended.append([place, bits])
print(json.dumps([results, ended]))
"""


def altered(place: int, bits: int) -> bytes:
    content = bytearray(SMALL.read_bytes())
    content[place] ^= bits
    return bytes(content)


def test_the_file_as_it_was_is_read() -> None:
    (record,) = read_records(SMALL)
    assert (record.trial, record["force_n"].tolist(), record.phase) == ("one", [*map(float, range(9))], ("in",) * 9)


def test_one_byte_that_makes_the_library_loop_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "data.h5").write_bytes(altered(*HANGS))
    monkeypatch.setattr(hdf5_guard, "_LEAST_CPU_S", 1)
    began = monotonic()
    refused(needleplan("identify", "force", tmp_path / "data.h5"), "libhdf5 did not finish reading it in 1 s")
    assert monotonic() - began < 20


def test_one_byte_that_makes_the_library_crash() -> None:
    with pytest.raises(DataError, match="data: is damaged: libhdf5 crashed when reading it"):
        parse_records(altered(*CRASHES))


def test_a_file_that_is_only_tried_is_refused_if_the_library_crashes_or_loops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hdf5_guard, "_LEAST_CPU_S", 1)
    path, child = tmp_path / "tried.h5", tmp_path / "child.py"
    path.write_bytes(SMALL.read_bytes())
    hdf5_guard.require_harmless(path)
    loops = "resource.setrlimit(resource.RLIMIT_CPU, (1, 2))\nwhile True: 0"
    programs = (("os.abort()", "crashed"), (loops, "did not"))
    with monkeypatch.context() as patched:
        patched.setattr(hdf5_guard, "_CHILD", child)
        for program, words in programs:
            child.write_text(f"import os, resource\n{program}")
            with pytest.raises(DataError, match=rf"tried\.h5: is damaged: libhdf5 {words}"):
                hdf5_guard.require_harmless(path)
    path.write_bytes(b"no HDF5 at all")  # what the library itself reports is for the reader of the file to find
    hdf5_guard.require_harmless(path)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_any_altered_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    files = 12  # about a third make the library loop until its limit of one second
    done = subprocess.run(
        [sys.executable, "-c", FUZZ, str(SMALL), str(files), str(files)],
        capture_output=True, text=True, check=True, timeout=600,
    )  # fmt: skip
    results, ended = json.loads(done.stdout)
    assert sum(results.values()) == files
    assert results["read"] > files / 4
    assert results["refused"] > files / 20
    monkeypatch.setattr(hdf5_guard, "_LEAST_CPU_S", 1)
    for place, bits in random.Random(0).sample(ended, min(len(ended), 5)):
        with pytest.raises(DataError, match="is damaged"):
            parse_records(altered(place, bits))


@pytest.mark.parametrize("length", [*range(0, 200, 9), 4096, 7455])
def test_a_truncated_file_is_refused_before_anything_is_started(length: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hdf5_guard.subprocess, "run", None)
    with pytest.raises(DataError):
        parse_records(SMALL.read_bytes()[:length])


def external_storage(file: h5py.File, secret: str) -> None:
    file.create_dataset("force_n", (9,), "f8", external=[(secret, 0, 72)])


def external_link(file: h5py.File, secret: str) -> None:
    file["force_n"] = h5py.ExternalLink(secret, "/one/force_n")


def soft_link(file: h5py.File, _: str) -> None:
    file["force_n"] = h5py.SoftLink("/force_n")


def virtual(file: h5py.File, secret: str) -> None:
    layout = h5py.VirtualLayout((9,), "f8")
    layout[:] = h5py.VirtualSource(secret, "one/force_n", (9,))
    file.create_virtual_dataset("force_n", layout)


def unallocated(file: h5py.File, _: str) -> None:
    file.create_dataset("force_n", (10**15,), "f8", chunks=(1000,))


def unallocated_time(file: h5py.File, _: str) -> None:
    del file["time_s"]
    file.create_dataset("time_s", (10**15,), "f8", chunks=(1000,))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (external_storage, "force_n: must be stored in the file itself"),
        (virtual, "force_n: must be stored in the file itself"),
        (external_link, ""),
        (soft_link, ""),
        (unallocated, "force_n = shape (1000000000000000,): must have the shape of time_s, (9,)"),
        (unallocated_time, "time_s = 1,000,000,000,000,000: must have at most 200,000,000 entries"),
    ],
)
def test_nothing_outside_of_the_file_is_read(make: Callable[[h5py.File, str], None], says: str) -> None:
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        file["time_s"] = np.arange(9.0)
        make(file, str(SMALL))
    if says:
        with pytest.raises(DataError) as refused:
            parse_records(image.getvalue(), accept_units=True)
        assert says in str(refused.value)
    else:  # as if the column were absent
        (record,) = parse_records(image.getvalue(), accept_units=True)
        assert "force_n" not in record.columns
