"""Step-wise insertions into wax phantoms and tissue, tracked electromagnetically, 100 mm deep."""

import numpy as np
import pytest

from needleplan.identification import Identification, agreement_of, combine, curvature
from needleplan.models import BicycleByDepth
from needleplan.recording import read_records
from needleplan.signals import FrameName, Record
from tests.real.shared import require

FOLDER = require("real_insertions")
TISSUES = ("phantomA", "phantomB", "phantomC", "exvivo")
SKIP_MM = 5.0
"""The first step into the tissue is not part of the path."""


def trials(tissue: str) -> list[Record]:
    return [read_records(path)[0] for path in sorted(FOLDER.glob(f"{tissue}_openloop_*.csv"))]


@pytest.fixture(scope="module")
def found() -> dict[str, Identification]:
    return {tissue: curvature.identify(trials(tissue), skip_mm=SKIP_MM) for tissue in TISSUES}


def test_every_file_is_read_and_what_was_left_out_is_said() -> None:
    paths = sorted(FOLDER.glob("*.csv"))
    records = [read_records(path)[0] for path in paths]
    assert len(records) == 13
    for path, record in zip(paths, records, strict=True):
        rows = len(path.read_text().splitlines()) - 1
        left_out = sum(int(note.split()[0]) for note in record.notes if "rows" in note)
        assert len(record) + left_out == rows
        assert 99 < record["depth_mm"].max() < 103
        assert 0.4 < np.median(np.diff(record["time_s"])) < 0.6


def test_the_path_begins_at_the_guide() -> None:
    """The needle leaves the guide within a millimetre and a half; the frame of the study begins 25 mm beside it."""
    for path in sorted(FOLDER.glob("*_openloop_*.csv")):
        (record,) = read_records(path)
        assert record.frame.name is FrameName.GUIDE
        start = record["depth_mm"] < 5
        assert np.abs([np.median(record[name][start]) for name in ("y_mm", "z_mm")]).max() < 1.5


@pytest.mark.study
def test_repeated_insertions_agree(found: dict[str, Identification]) -> None:
    for each in found.values():
        assert each.findings[0].name == "agreement of trials"
        assert each.findings[0].p_value is not None
        assert each.findings[0].p_value > 0.05


@pytest.mark.slow
def test_curvature_by_tissue(found: dict[str, Identification]) -> None:
    bends = {tissue: each.estimates["curvature_per_mm"] for tissue, each in found.items()}
    assert -1 / 5000 < bends["phantomA"].low < bends["phantomA"].high < 1 / 5000
    depths = np.linspace(0.0, 100.0, 1001)
    for tissue, low_mm, high_mm in (("phantomB", 2000, 5000), ("phantomC", 2000, 5000), ("exvivo", 1000, 2500)):
        assert bends[tissue].identified
        model = found[tissue].model
        assert isinstance(model, BicycleByDepth)
        assert low_mm < 1 / np.mean(model.curvature_at(depths)) < high_mm


def test_the_paths_are_no_arcs(found: dict[str, Identification]) -> None:
    """Nearly all paths are straighter in their second half: the curvature fades with depth."""
    changes = [each for tissue in TISSUES for each in found[tissue].findings if each.name.startswith("change")]
    assert len(changes) == 12
    assert all(each.statistic < 0 for each in changes)
    assert sum(each.p_value is not None and each.p_value < 0.05 for each in changes) >= 6


def test_the_other_plane_is_nearly_straight() -> None:
    for tissue in ("phantomA", "phantomC"):
        across = [
            curvature.insertion_of(each, plane="xz", skip_mm=SKIP_MM, segments=1).whole for each in trials(tissue)
        ]
        values, sds = [path.curvature_per_mm for path in across], [path.interval_sd_per_mm for path in across]
        assert agreement_of(values, sds).agree
        low, high = combine(values, sds).interval()
        assert low < 0 < high
