"""One server for all tests of a process."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

import needleplan as npl
from tests.browser.browser import opened, wait_for
from tests.page.served import Served, served


@pytest.fixture(scope="session")
def server(small: npl.Scenario, table: npl.PolicyTable) -> Iterator[Served]:
    with served(small, table) as found:
        yield found


@pytest.fixture
def page(browser: Browser, server: Served) -> Iterator[Page]:
    with opened(browser, server) as found:
        wait_for(found, "done")
        yield found
