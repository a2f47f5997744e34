"""`progress=True` shows a bar on a terminal or in a notebook, and removes it at the end, also after an error."""

import io
import sys
from types import SimpleNamespace
from typing import Any

import IPython
import numpy as np
import pytest
from IPython.display import DisplayHandle

import needleplan as npl
from needleplan.extras.progress_bar import progress_bar

MDP = npl.mdp.TabularMdp([np.eye(2)], [[1.0], [0.0]], discount=0.9)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def outputs(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, str]]:
    """The states of the output of a cell, in the kernel of a notebook."""
    states: list[dict[str, str]] = []
    monkeypatch.setattr(IPython, "get_ipython", lambda: SimpleNamespace(kernel=None))
    for name in ("display", "update"):
        monkeypatch.setattr(DisplayHandle, name, lambda _, data, **__: states.append(data))
    return states


def test_a_notebook_shows_a_bar_and_removes_it(outputs: list[dict[str, str]]) -> None:
    npl.mdp.solve(MDP, progress=True)
    assert outputs[1]["text/html"].startswith("<progress></progress> solving: ")
    assert not any(outputs[-1].values())


def fail() -> None:
    with progress_bar() as show:
        show("a < b", 0.5)
        raise RuntimeError


def test_a_bar_disappears_after_an_error(outputs: list[dict[str, str]]) -> None:
    with pytest.raises(RuntimeError):
        fail()
    assert outputs[1] == {"text/plain": "a < b", "text/html": '<progress value="0.500"></progress> a &lt; b'}
    assert outputs[2] == {"text/plain": "", "text/html": ""}


@pytest.mark.parametrize("progress", [True, False, None])
@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_a_terminal_shows_a_bar_if_it_is_wanted(
    stream: type[io.StringIO], progress: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", stream())
    npl.mdp.value_iteration(MDP, progress=progress)
    assert ("solving: " in sys.stderr.getvalue()) == (stream is Terminal and progress is True)


def test_a_bar_of_plan_leaves_its_table_as_it_is(outputs: list[dict[str, str]]) -> None:
    scenario = npl.Scenario.read("unreachable")
    assert npl.plan(scenario, True).digest == npl.plan(scenario).digest
    assert "sweeps, residual" in outputs[1]["text/plain"]
