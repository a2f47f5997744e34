"""A command that a stop has overtaken on the wire: the cause of the stop is told, and not that the stage refused it."""

import threading

import pytest

from needleplan.control.safety import Cause, GuardedStage
from needleplan.errors import DeviceFault, MotionRefused
from tests.control.safety.bench import Bench


@pytest.mark.parametrize("by", ["a blocked guard", "a validation that fails"])
def test_a_command_that_a_stop_without_the_lock_has_overtaken_hides_no_cause(
    bench: Bench, guard: GuardedStage, by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stage refuses the command, because the stop had a higher number: that is no failure of the stage."""
    raised: list[MotionRefused] = []

    def stop() -> None:
        if by == "a validation that fails":
            guard.fail(ValueError("a defect"))
            return
        with pytest.raises(MotionRefused) as error:
            guard.check()
        raised.append(error.value)

    def superseded(*_: float) -> None:
        other, free = threading.Thread(target=stop), threading.Event()
        holder = threading.Thread(target=hold, args=(guard, held := threading.Event(), free))
        if by == "a blocked guard":
            holder.start()
            assert held.wait(20)
        other.start()
        other.join(20)
        free.set()
        if by == "a blocked guard":
            holder.join(20)
        raise DeviceFault("robot: insert: a later command such as a stop arrived before it")

    monkeypatch.setattr(bench.stage, "insert", superseded)
    with pytest.raises(MotionRefused, match="stop_ordered"):
        guard.insert(20.0, 5.0)
    guard.check()
    expected = Cause.LOOP_LATE if by == "a blocked guard" else Cause.GUARD_FAILED
    assert guard.state.first == {expected}
    assert Cause.STAGE_FAULT not in guard.state.latched
    assert len(raised) == (by == "a blocked guard")


def hold(guard: GuardedStage, held: threading.Event, free: threading.Event) -> None:
    with guard._lock:
        held.set()
        free.wait(20)
