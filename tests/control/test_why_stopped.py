"""The reason of a stop names the fault of a device, also if the thread that reads passes it on late."""

from collections import deque
from types import SimpleNamespace
from typing import Any, cast

import pytest

from needleplan.control._needle import NeedleState
from needleplan.errors import DeviceFault


class LateFeed:
    """A feed with nothing to read before it has been asked so often; then its thread passes the fault on."""

    def __init__(self, looks: int) -> None:
        self.answers: deque[bool] = deque([False] * looks)

    def next(self, timeout_s: float) -> None:
        if timeout_s == 0.0:
            return
        if not self.answers:
            raise DeviceFault("robot: another sender ordered a stop")
        self.answers.popleft()


def needle(looks: int, *, failed: bool) -> NeedleState:
    stopped = NeedleState.__new__(NeedleState)
    state = SimpleNamespace(first={"stage_fault"}, present={"stage_fault"}, latched={"stage_fault"})
    stopped._guard = cast("Any", SimpleNamespace(state=state, stage_has_failed=failed, reason=""))
    stopped._feed = cast("Any", LateFeed(looks))
    return stopped


@pytest.mark.parametrize("looks", [0, 3])
def test_a_fault_that_comes_late_is_named(looks: int) -> None:
    assert needle(looks, failed=True).why_stopped() == "robot: another sender ordered a stop; stopped: stage_fault"


def test_without_a_failed_reading_and_without_an_end_nothing_is_awaited() -> None:
    assert needle(0, failed=False).why_stopped() == "stopped: stage_fault"
    assert needle(1000, failed=True).why_stopped() == "stopped: stage_fault"
