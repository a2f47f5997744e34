"""What the page on the diagnosis says of paths that were measured: no truth is known there."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO

import pytest

from tests import pages
from tests.real.shared import require

FOLDER = require("real_insertions")
PAGE = pages.ROOT / "docs/explanation/diagnosis.md"


@pytest.mark.study
def test_the_page_says_what_is_said_of_them() -> None:
    blocks = list(pages.blocks(PAGE))
    (index,) = [i for i, each in enumerate(blocks) if "read_stepwise_insertion" in each.text]
    printed = StringIO()
    with redirect_stdout(printed):
        exec(compile(blocks[index].text, str(PAGE), "exec"), {"folder": str(FOLDER)})
    assert printed.getvalue() == blocks[index + 1].text
    assert "named" not in printed.getvalue()
