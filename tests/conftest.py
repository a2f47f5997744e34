"""One small scenario and its table, for all tests that only look at them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

import needleplan as npl

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# No test is timed: an example takes long on a busy machine. The other settings stay as they are, here or in CI.
settings.register_profile("untimed", settings(), deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest tests first: at the end, one processor would wait for them."""
    items.sort(key=lambda item: item.get_closest_marker("first") is None)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """The one browser of a process: a second one would not start beside it."""
    from tests.browser.browser import chromium

    with chromium() as found:
        yield found


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
