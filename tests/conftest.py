"""One small scenario and its table, for all tests that only look at them."""

from __future__ import annotations

from pathlib import Path

import pytest

import needleplan as npl

SMALL = """schema = "needleplan.scenario/1"
title = "Small"
[workspace]
width_mm = 60.0
height_mm = 40.0
[[obstacle]]
name = "rod"
polygon_mm = [[20, 0], [30, 0], [30, 15], [25, 18], [20, 15]]
[target]
center_mm = [50, 25]
radius_mm = 2
[needle]
curvature_radius_mm = 40
[motion]
headings = 36
[solver]
partitions = [6, 4]
tolerance = 1e-3
"""


@pytest.fixture(scope="session")
def small() -> npl.Scenario:
    return npl.Scenario.from_toml(SMALL)


@pytest.fixture(scope="session")
def table(small: npl.Scenario) -> npl.PolicyTable:
    return npl.plan(small)


@pytest.fixture(scope="session")
def table_file(table: npl.PolicyTable, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tables") / "small.h5"
    table.write(path)
    return path
