"""The TOML writer: what is written reads back as it was."""

import math
import tomllib
from datetime import date
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.config import Commented, toml_text

_TEXTS = st.text(st.characters(codec="utf-8"), max_size=12)
_VALUES = st.recursive(
    st.one_of(st.booleans(), st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False), _TEXTS),
    lambda values: st.lists(values, max_size=3) | st.dictionaries(_TEXTS, values, max_size=3),
    max_leaves=20,
)
DOCUMENTS = st.dictionaries(_TEXTS, _VALUES, max_size=5)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(DOCUMENTS)
def test_any_document_reads_back_as_it_was(document: dict[str, Any]) -> None:
    assert tomllib.loads(toml_text(document)) == document


@settings(deadline=None)
@given(DOCUMENTS, st.text(st.characters(codec="utf-8", exclude_categories=["Cc"]), max_size=30))
def test_comments_change_nothing(document: dict[str, Any], comment: str) -> None:
    line = " ".join(comment.split())
    commented = {key: Commented(value, line) for key, value in document.items()}
    assert tomllib.loads(toml_text(commented, comment)) == document


def test_the_layout() -> None:
    document = {
        "table": {"value": 1, "inner": {"value": 2.0}, "rows": [{"value": Commented(3, "mm")}]},
        "row": [{"inner": {"value": True}}],
        "title": "first",
        "empty": [],
    }
    assert toml_text(document, "one\ntwo") == (
        '# one\n# two\ntitle = "first"\nempty = []\n\n[table]\nvalue = 1\n\n[table.inner]\nvalue = 2.0\n\n'
        "[[table.rows]]\nvalue = 3  # mm\n\n[[row]]\n[row.inner]\nvalue = true\n"
    )


def test_numbers_of_numpy_and_numbers_that_are_not_finite() -> None:
    found = tomllib.loads(toml_text({"a": np.float64(0.1), "b": np.arange(3), "c": [math.inf, -math.inf]}))
    assert found == {"a": 0.1, "b": [0, 1, 2], "c": [math.inf, -math.inf]}
    assert math.isnan(tomllib.loads(toml_text({"a": math.nan}))["a"])


def test_what_toml_cannot_hold_is_refused() -> None:
    with pytest.raises(TypeError, match="TOML cannot hold a date"):
        toml_text({"a": date(2026, 1, 1)})
