"""Every example in a docstring of the package runs and prints what it shows."""

import doctest
import importlib
import importlib.util
import pkgutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import needleplan as npl
from needleplan.planning import PolicyTable, plan

PACKAGE = Path(npl.__file__).parent
MODULES = [
    each.name for each in pkgutil.walk_packages([str(PACKAGE)], "needleplan.")
    if not each.name.endswith(("_ppvi", "__main__"))
]  # fmt: skip
WITH_EXAMPLES = [
    name for name in MODULES
    if ">>> " in Path(str(importlib.util.find_spec(name).origin)).read_text(encoding="utf-8")  # type: ignore[union-attr]
]  # fmt: skip
SLOW = {"needleplan.diagnosis._diagnosis"}  # a whole diagnosis
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE | doctest.IGNORE_EXCEPTION_DETAIL


@pytest.fixture(scope="module")
def planned_once() -> Iterator[None]:
    """Solve a shipped scenario once for all examples; other scenarios are solved where they stand."""
    kept = cache(plan)

    def plan_once(scenario: Any, progress: Any = None) -> PolicyTable:
        return kept(scenario) if isinstance(scenario, str) and progress is None else plan(scenario, progress)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(npl, "plan", plan_once)
        yield


@pytest.mark.usefixtures("planned_once")
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in WITH_EXAMPLES]
)
def test_examples(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # examples may write files
    module = importlib.import_module(name)
    results = doctest.testmod(module, optionflags=OPTIONS, verbose=False)
    assert results.attempted > 0
    assert results.failed == 0, f"see the captured output: {results}"
