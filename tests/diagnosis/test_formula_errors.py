"""Members of a set that may be errors of the formula of a stronger one."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from needleplan.diagnosis import Settings
from needleplan.diagnosis._posterior import Posterior

Logs = dict[tuple[tuple[str, ...], str], float]


def cleared(logs: Logs) -> tuple[Posterior, list[str]]:
    """Return what is left of a posterior that has only log probabilities, and the remarks."""
    problem: Any = SimpleNamespace(settings=Settings())
    nothing: Any = None
    return Posterior(problem, (), nothing, {}, logs, nothing, np.zeros(0)).without_formula_errors()


def test_a_companion_that_gains_less_than_an_error_of_thirty_percent_is_left_out() -> None:
    left, remarks = cleared(
        {((), ""): -1000.0, (("drift",), ""): -900.0, (("bias",), ""): -80.0, (("bias", "drift"), ""): 0.0}
    )
    assert remarks == ["drift may be an error of the formula of bias: it gains 80 nats beside 900"]
    assert left.ranked[0][1:] == (("bias",), "")
    assert set(left.logs) == {((), ""), (("drift",), ""), (("bias",), "")}
    assert sum(map(math.exp, left.logs.values())) == pytest.approx(1.0)


def test_one_that_gains_more_stays() -> None:
    logs: Logs = {((), ""): -1000.0, (("drift",), ""): -900.0, (("bias",), ""): -82.0, (("bias", "drift"), ""): 0.0}
    left, remarks = cleared(logs)
    assert remarks == []
    assert left.logs == pytest.approx(logs)


def test_a_function_beside_a_strong_effect_is_left_out_too() -> None:
    left, remarks = cleared({((), ""): -1000.0, (("bias",), ""): -20.0, (("bias",), "time"): 0.0, ((), "time"): -300.0})
    assert remarks == ["time may be an error of the formula of bias: it gains 20 nats beside 300"]
    assert left.ranked[0][1:] == (("bias",), "")


def test_nothing_and_one_effect_are_what_they_were() -> None:
    alone: list[Logs] = [{((), ""): 0.0}, {((), ""): -50.0, (("bias",), ""): 0.0}]
    assert [cleared(logs)[1] for logs in alone] == [[], []]
