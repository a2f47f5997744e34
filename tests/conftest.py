"""For all tests: default signals, failures that are shown at once, one browser, one small scenario and its table."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

import needleplan as npl

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# No test is timed: an example takes long on a busy machine. With the default of 100 examples the property tests take
# more than twice as long. The other settings stay as they are, here or in CI.
settings.register_profile(
    "untimed", settings(), deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow]
)
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


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Undo ignored signals: a shell that starts the tests in the background, or `nohup`, makes them ignore these.

    A child process inherits an ignored signal, but has the default action of a signal that its parent handles. So the
    tests themselves outlive a closed terminal under `nohup`, and the programs that they start do not.
    Python undoes SIGPIPE for its children by itself.
    """
    for number, handler in (
        (signal.SIGINT, signal.default_int_handler),
        (signal.SIGTERM, signal.SIG_DFL),
        (signal.SIGHUP, lambda *_: None),
    ):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)


class FailuresAtOnce:
    """Shows a failure as soon as it is known; pytest would show all of them after the last test."""

    def __init__(self, terminal: pytest.TerminalReporter) -> None:
        self.terminal = terminal

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and self.terminal.config.option.tbstyle != "no":
            self.terminal.write_line("")
            self.terminal.write_sep("_", f"{report.nodeid} ({report.when})", red=True, bold=True)
            self.terminal._outrep_summary(report)
            report._pdbshown = True  # type: ignore[attr-defined]  # pytest shows no failure again that has this mark


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    """Show failures at once in the process that has the terminal."""
    terminal = config.pluginmanager.get_plugin("terminalreporter")
    if terminal is not None:
        config.pluginmanager.register(FailuresAtOnce(terminal), "failures_at_once")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest tests first: at the end, one processor would wait for them."""
    items.sort(key=lambda item: item.get_closest_marker("first") is None)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """The one browser of a process: a second one would not start beside it."""
    from tests.browser.browser import chromium

    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def few_executions() -> Iterator[None]:
    """Compare entries of 3D tables by 100 executions each instead of 2,000, for tests that do not judge the success."""
    from needleplan.planning._space_ranking import EntryRanking

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(EntryRanking, "runs", 100)
        yield


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
