"""What the page on the diagnosis says of paths that were measured: no truth is known there."""

import numpy as np
import pytest

from needleplan.diagnosis import diagnose
from needleplan.models import SpatialBicycle
from needleplan.recording import read_records
from needleplan.signals import Record, Role
from tests import pages
from tests.real.shared import require

FOLDER = require("real_insertions")
PAGE = pages.ROOT / "docs/explanation/diagnosis.md"


def trial(tissue: str, number: int, role: Role) -> Record:
    """Return a path from the entry: the first step into the tissue is no part of it."""
    record = read_records(FOLDER / f"{tissue}_openloop_0{number}.csv")[0]
    inside = np.flatnonzero(record["depth_mm"] > 5)[0]
    columns = {name: record[name][inside:] for name in ("depth_mm", "x_mm", "y_mm", "z_mm")}
    for name in ("y_mm", "z_mm"):
        columns[name] = columns[name] - np.median(record[name][:inside])
    time_s = 0.5 * np.arange(len(columns["depth_mm"]), dtype=np.float64)
    return Record({"time_s": time_s, **columns}, record.trial, role)


@pytest.mark.study
def test_the_page_says_what_is_said_of_them() -> None:
    lines = []
    for tissue in ("phantomA", "exvivo"):
        trials = [trial(tissue, 1, Role.TRAIN), trial(tissue, 2, Role.TRAIN), trial(tissue, 3, Role.HOLDOUT)]
        depth, aside = (np.concatenate([record[name] for record in trials[:2]]) for name in ("depth_mm", "y_mm"))
        slope, bend = np.linalg.lstsq(np.column_stack([depth, depth**2 / 2]), aside)[0]
        bases = {"straight": SpatialBicycle(1e-6), "one arc": SpatialBicycle(max(bend, 1e-6), heading_y_rad=slope)}
        for name, base in bases.items():
            found = diagnose(base, trials)
            residuals = [case.measured - case.predicted for case in found.calibration.training]
            rms_mm = np.sqrt(np.mean(np.concatenate(residuals) ** 2))
            sets = " or ".join(map("+".join, found.decision.tied))
            cause = f"along {found.decision.axis}" if found.decision.axis else sets
            lines.append(f"{tissue:8} {name:8} {rms_mm:.2f} mm  {found.verdict}: {cause}\n")
    (told,) = [block.text for block in pages.blocks(PAGE) if block.text.startswith("phantomA")]
    assert "".join(lines) == told
    assert "named" not in told
