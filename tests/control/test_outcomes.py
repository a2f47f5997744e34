"""Outcomes of a run: stopped and refused are what was ordered and measured."""

import threading

import pytest

from needleplan.control import ExecutedStep, InsertionOutcome
from needleplan.errors import DeviceFault
from tests.control.scenes import a_lab, insertion_in, run_in
from tests.control.test_insertion import Stopping


class StoppingTheGuard(Stopping):
    """Stops the guard from another thread, and not the run."""

    def step(self, step: ExecutedStep) -> None:
        if step.number == self.after and self.insertion:
            other = threading.Thread(target=self.insertion.guard.stop)
            other.start()
            other.join()


def test_a_stop_of_the_guard_by_another_thread_is_a_stop_and_no_fault() -> None:
    listener = StoppingTheGuard(3)
    listener.insertion = insertion_in(a_lab(), listeners=[listener])
    report = listener.insertion.run()
    assert (report.outcome, report.cause) == (InsertionOutcome.STOPPED, "a stop was ordered at the guard")


@pytest.mark.parametrize("seconds", [0.05, 0.0])
def test_a_first_command_that_fails_is_a_refusal_only_if_nothing_moved(
    seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = a_lab()
    begin = lab.stage.insert

    def lost(depth_mm: float, velocity_mm_s: float) -> None:
        if seconds:
            begin(depth_mm, velocity_mm_s)
        lab.advance(seconds)
        raise DeviceFault("robot: insert: no answer within 0.03 s")

    monkeypatch.setattr(lab.stage, "insert", lost)
    report = run_in(lab)
    assert (lab.plant.insertion.position > 0.02) == bool(seconds)
    assert report.outcome is (InsertionOutcome.FAULT if seconds else InsertionOutcome.REFUSED)
    assert "no answer within" in report.cause
