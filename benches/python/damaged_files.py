"""Damage files in thousands of ways, and count what the program does with them.

python benches/python/damaged_files.py --json benches/results/damaged_files.json > benches/results/damaged_files.md
python benches/python/damaged_files.py --files 100              # short test run

Each file has one flipped bit or one altered byte, at a random place, and is read in a process of its own with a limit
of 2 s of processor time. For HDF5 data, this process stands for the child process in which the program reads them;
there, "crash" and "too slow" become a refusal. A table that crashes is tried again as the program does it, isolated.
"""

import argparse
import json
import os
import random
import sys
import tempfile
import types
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import machine
import numpy as np

import needleplan as npl
from needleplan.artifacts import _hdf5_child as hdf5_child
from needleplan.artifacts import hdf5_guard
from needleplan.devices import ForceSample, Stamp
from needleplan.errors import InputError
from needleplan.planning._seal import SEAL_BYTES, seal
from needleplan.recording import (
    FORCE,
    Recorder,
    Recording,
    Session,
    WhenFull,
    parse_records,
    recover,
    write_records,
)
from needleplan.scenario import Grid
from needleplan.signals import Record

CPU_S, MEMORY_BYTES = 2, 2**32
RESULTS = ("refused", "read unchanged", "read changed", "other exception", "crash", "too slow")
REFUSED, SAME, CHANGED, OTHER = range(4)
HARMLESS = "refused where a child process tries it"


@dataclass(frozen=True)
class Case:
    """A kind of file, its damage, and a function that reads the damaged bytes and returns what it has read."""

    name: str
    whole: bytes
    damage: Callable[[bytes, random.Random], bytes]
    read: Callable[[bytes, Path], object]


def flipped_bit(content: bytes, chance: random.Random) -> bytes:
    """Return the bytes with one bit flipped."""
    return altered(content, chance.randrange(len(content)), 1 << chance.randrange(8))


def altered_byte(content: bytes, chance: random.Random) -> bytes:
    """Return the bytes with one byte altered."""
    return altered(content, chance.randrange(len(content)), chance.randrange(1, 256))


def sealed_again(content: bytes, chance: random.Random) -> bytes:
    """Return a table with one byte altered behind the seal, and a seal that agrees."""
    body = altered_byte(content[SEAL_BYTES:], chance)
    return seal(memoryview(body)) + body


def altered(content: bytes, place: int, bits: int) -> bytes:
    """Return the bytes with the bits of one byte flipped."""
    return content[:place] + bytes([content[place] ^ bits]) + content[place + 1 :]


def cases(folder: Path) -> list[Case]:
    """Return all cases; the files are made in a folder."""
    small = npl.Scenario.read("four_obstacles_thesis")
    small = replace(small, grid=Grid((8.0, 8.0), "interpolated"), motion=replace(small.motion, headings=12))
    npl.plan(small).write(folder / "table.h5")
    with Recorder(folder / "run.mcap", Session("run", monotonic_ns=0, wall_ns=10**18), when_full=WhenFull.WAIT) as run:
        force = run.channel("/force", FORCE)
        for number in range(400):
            force.put(number * 5_000_000, ForceSample(Stamp(number, number), (0.0, 0.0, 0.1), (0.0, 0.0, 0.0)))
    time_s = np.arange(60) / 10
    record = Record({"time_s": time_s, "depth_mm": 5 * time_s, "force_n": np.sin(time_s)}, "one", phase=("in",) * 60)
    for name in ("data.h5", "data.csv"):
        write_records([record], folder / name)
    table, run_, hdf5, csv = ((folder / name).read_bytes() for name in ("table.h5", "run.mcap", "data.h5", "data.csv"))
    return [
        Case("table, one bit", table, flipped_bit, read_table),
        Case("table, one byte, sealed again", table, sealed_again, read_table),
        Case("recording, one bit", run_, flipped_bit, read_recording),
        Case("recording, one bit, recovered", run_, flipped_bit, recovered),
        Case("HDF5 data, one byte", hdf5, altered_byte, read_data),
        Case("CSV data, one byte", csv, altered_byte, read_data),
        Case("scenario, one byte", small.to_toml().encode(), altered_byte, read_scenario),
    ]


def read_table(content: bytes, folder: Path) -> object:
    """Return the digest of a table."""
    (folder / "damaged.h5").write_bytes(content)
    return npl.PolicyTable.read(folder / "damaged.h5", isolated=False).digest


def read_recording(content: bytes, folder: Path) -> object:
    """Return the messages of a recording."""
    (folder / "damaged.mcap").write_bytes(content)
    return list(Recording.read(folder / "damaged.mcap").messages())


def recovered(content: bytes, folder: Path) -> object:
    """Return the samples of a recovered recording; fewer than all count as unchanged if the loss is reported."""
    (folder / "damaged.mcap").write_bytes(content)
    found = recover(folder / "damaged.mcap", folder / "again.mcap", overwrite=True)
    samples = [each.values for each in Recording.read(folder / "again.mcap").messages(["/force"])]
    every = all(each["sequence"] == each["received_ns"] and each["force_z_n"] == 0.1 for each in samples)
    return every and (len(samples) == 400 or bool(found.damaged_bytes))


def read_data(content: bytes, _: Path) -> object:
    """Return the columns of a data file."""
    (record,) = parse_records(content, accept_units=True)
    return {name: values.tobytes() for name, values in record.columns.items()}, record.phase, record.role, record.trial


def read_scenario(content: bytes, _: Path) -> object:
    """Return the digest of a scenario."""
    return npl.Scenario.from_toml(content.decode("utf-8", "replace")).digest


def run(case: Case, files: int, folder: Path) -> Counter[str]:
    """Damage a file so many times, and return the number of files by result."""
    chance, found, whole = random.Random(case.name), Counter[str](), case.read(case.whole, folder)
    for _ in range(files):
        content = case.damage(case.whole, chance)
        process = os.fork()
        if not process:
            os._exit(result(case, content, whole, folder))
        status = os.waitpid(process, 0)[1]
        if os.WIFSIGNALED(status) and case.read is read_table:
            found[HARMLESS if refused_isolated(content, folder) else "crash even so"] += 1
        if os.WIFSIGNALED(status):
            found[RESULTS[4 + (os.WTERMSIG(status) in (9, 24))]] += 1
        else:
            found[RESULTS[os.WEXITSTATUS(status)]] += 1
    return found


def refused_isolated(content: bytes, folder: Path) -> bool:
    """Return whether a table is refused if a child process tries it first, as the program does."""
    (folder / "isolated.h5").write_bytes(content)
    try:
        npl.PolicyTable.read(folder / "isolated.h5", isolated=True)
    except InputError:
        return True
    return False


def result(case: Case, content: bytes, whole: object, folder: Path) -> int:
    """Read a damaged file in this process, which was forked for it, and return the number of the result."""
    hdf5_child.limit(CPU_S, MEMORY_BYTES)
    in_process = types.SimpleNamespace(run=run_child, PIPE=0, DEVNULL=0, TimeoutExpired=TimeoutError)
    hdf5_guard.subprocess = in_process  # type: ignore[attr-defined]
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    try:
        return SAME if case.read(content, folder) == whole else CHANGED
    except InputError:
        return REFUSED
    except BaseException:
        return OTHER


def run_child(command: list[str], input: bytes, **_: object) -> types.SimpleNamespace:
    """Do in this process what the child process does."""
    return types.SimpleNamespace(returncode=0, stdout=hdf5_child.main(command[5:], input))


def main() -> int:
    """Run all cases, print a table, and with --json write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=2000, help="damaged files of each case")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about = machine.description()
    found = {}
    with tempfile.TemporaryDirectory() as name:
        for case in cases(Path(name)):
            found[case.name] = run(case, options.files, Path(name))
            print(case.name, dict(found[case.name]), file=sys.stderr)
    print("# Damaged files\n")
    print(f"{options.files:,} files of each case.\n\n| | {' | '.join(RESULTS)} |\n|---|{'--:|' * len(RESULTS)}")
    for name, counts in found.items():
        print(f"| {name} | {' | '.join(str(counts[each]) for each in RESULTS)} |")
    for name, counts in found.items():
        for more in set(counts) - set(RESULTS):
            print(f"\n{name}: {counts[more]} {more}.")
    if options.json:
        options.json.write_text(
            json.dumps({"machine": about, "files": options.files, "results": found}, indent=1) + "\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
