"""The force library: `identify force --force-library` stores, `info` lists and searches."""

import json
from pathlib import Path

import numpy as np
import pytest

from needleplan.identification.force_library import ForceLibrary
from needleplan.models import simulate
from needleplan.recording import write_records
from needleplan.signals import Record, insertion_cycles
from tests.cli.commands import needleplan, refused

NAMES = ("--needle-name", "18 GA", "--tissue-name", "gel")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One insertion to 60 mm at 10 mm/s and back, with noise of the sensor."""
    motion = insertion_cycles(60.0, 10.0)
    force = simulate(ForceLibrary.read("published").combinations[0].model, motion).output
    force = force + np.random.default_rng(0).normal(0, 2e-3, force.shape)
    columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    path = tmp_path_factory.mktemp("data") / "force.csv"
    write_records([Record(columns | {"force_n": force}, "first")], path)
    return path


@pytest.mark.slow
def test_what_was_identified_is_stored_once_and_found_again(data: Path, tmp_path: Path) -> None:
    identify = ("identify", "force", data, "--average", "1", "--force-library", "library.toml", *NAMES)
    done = needleplan(*identify, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (stored,) = ForceLibrary.read(tmp_path / "library.toml").combinations
    assert (stored.needle, stored.tissue, stored.velocity_mm_s) == ("18 GA", "gel", 10.0)
    assert stored.depth_mm == pytest.approx(60, abs=0.1)
    assert stored.mae_n == pytest.approx(1.6e-3, abs=5e-4)
    assert stored.source == "needleplan identify force: first"
    assert len(stored.digests) == 1
    said = json.loads(done.stdout)
    assert said["combination"]["parameters"] == said["parameters"] == stored.model.values()
    assert stored.intervals["sigma0"] == (said["estimates"]["sigma0"]["low"], said["estimates"]["sigma0"]["high"])
    before = (tmp_path / "library.toml").read_bytes()
    refused_again = needleplan(*identify, "--json", cwd=tmp_path)
    assert refused_again.returncode == 2
    assert "18 GA in gel at 10 mm/s: is already in the library; --force replaces it" in refused_again.stderr
    assert (tmp_path / "library.toml").read_bytes() == before
    listed = needleplan("info", "library.toml", cwd=tmp_path)
    assert listed.returncode == 0
    assert "1 of 1 combinations" in listed.stdout
    assert "95 % interval" in listed.stdout


def test_the_shipped_library_is_listed_and_searched() -> None:
    lines = needleplan("info", "published").stdout.splitlines()
    assert lines[0] == "Chapter 2 of the thesis: 5 of 5 combinations"
    assert len(lines) == 6
    found = needleplan("info", "published", "--needle-name", "18 ga", "--velocity", "8", "--json")
    (row,) = json.loads(found.stdout)["combinations"]
    assert (row["velocity_mm_s"], row["velocity_ratio"], row["parameters"]["sigma1"]) == (10.0, 1.25, 2.46)
    assert (
        "1.25 x the requested speed" in needleplan("info", "published", "--needle-name", "18", "--velocity", "8").stdout
    )
    assert len(needleplan("info", "published", "--verbose").stdout.splitlines()) == 6 + 5 * 8


def test_nothing_that_fits_is_the_answer_no() -> None:
    done = needleplan("info", "published", "--needle-name", "18 GA", "--tissue-name", "6 %")
    assert done.returncode == 1
    assert "no combination of the library matches the search" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["identify", "curvature", "x.csv", "--force-library", "a.toml", *NAMES],
            ["--force-library = curvature", "must be force"],
        ),
        (
            ["identify", "force", "x.csv", "--force-library", "a.toml"],
            ["--needle-name: is missing", "--tissue-name: is missing"],
        ),
        (
            ["identify", "force", "x.csv", *NAMES],
            [": is an option for --force-library", "--tissue-name = "],
        ),
        (["identify", "force", "a.toml", "--force-library", "a.toml", *NAMES], ["a.toml", "which is an input file"]),
        (["identify", "force", "x.csv", "--force-library", "no/a.toml", *NAMES], ["no such folder"]),
        (["info", "none.toml"], ["none.toml: no such file, and no shipped library of that name (published)"]),
        (["info", "published", "--velocity", "-1"], ["velocity_mm_s = -1.0: must be a positive number"]),
        (["info", "table.h5", "--needle-name", "x"], ["table.h5: --needle-name = x: is an option for a library"]),
    ],
)
def test_what_is_wrong_is_said_before_the_work(arguments: list[str], words: list[str], tmp_path: Path) -> None:
    refused(needleplan(*arguments, cwd=tmp_path), *words)


def test_a_library_that_is_broken_is_refused_before_the_work(data: Path, tmp_path: Path) -> None:
    (tmp_path / "library.toml").write_text('schema = "needleplan.force-library/1"\ntitel = "x"\n')
    done = needleplan("identify", "force", data, "--force-library", tmp_path / "library.toml", *NAMES)
    refused(done, "titel: unknown key", 'did you mean "title"')
