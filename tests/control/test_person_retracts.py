"""A person retracts the needle while the loop runs, in the lab twin, on simulated time."""

from dataclasses import replace

import pytest

from needleplan.control import (
    CommandKind,
    InsertionOutcome,
    RunEventName,
)
from needleplan.control.safety import GuardedStage, Order
from tests.control.person import Person
from tests.control.scenes import FAST, NOISY, WIDE, a_lab, insertion_in, run_in


@pytest.mark.slow
def test_after_a_retraction_the_loop_does_not_go_back_to_its_old_goal() -> None:
    lab = a_lab(NOISY, 3)
    person = Person(lab, 8.0, lambda guard: guard.retract(lab.plant.insertion.position - 3.0, 1.0, "anna"))
    person.insertion = insertion_in(lab, listeners=[person])
    report = person.insertion.run()
    (event,) = [each for each in report.events if each.name is RunEventName.RETRACTED]
    inserts = [each for each in person.commands if each.time_ns > person.began_ns and each.kind is CommandKind.INSERT]
    decided = [each for each in report.steps if each.time_ns >= event.time_ns]
    assert decided[0].path_mm == pytest.approx(person.depths_mm[-1], abs=0.3)
    assert inserts[0].time_ns >= decided[0].time_ns >= event.time_ns
    assert inserts[0].goal == pytest.approx(decided[0].path_mm + decided[0].length_mm)


@pytest.mark.slow
def test_a_needle_that_a_person_pulled_out_is_not_inserted_again() -> None:
    lab = a_lab(NOISY, 3)
    person = Person(lab, 8.0, lambda guard: guard.retract(-5.0, 20.0, "anna"))
    person.insertion = insertion_in(lab, listeners=[person])
    report = person.insertion.run()
    assert report.outcome is InsertionOutcome.STOPPED
    assert "pulled the needle out" in report.cause
    lab.advance(1.0)
    assert lab.plant.insertion.position == pytest.approx(-5.0, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("stops", [False, True])
def test_a_slow_retraction_outlives_the_run_unless_a_person_stops_it(stops: bool) -> None:
    """The time of the run ends during the retraction; the loop keeps the heartbeats going until it is over."""
    lab = a_lab(NOISY, 3)
    goal_mm: list[float] = []

    def retract(guard: GuardedStage) -> None:
        goal_mm.append(lab.plant.insertion.position - 12.0)
        guard.retract(goal_mm[0], 1.0, "anna")

    person = Person(lab, 6.0 if stops else 1e9, retract)
    person.order = Order.STOP
    person.insertion = insertion_in(lab, listeners=[person], limits=replace(WIDE, run_s=5.0))
    report = person.insertion.run()
    assert report.outcome is InsertionOutcome.FAULT
    assert "time_exceeded" in report.cause
    lab.advance(1.0)
    reached_mm = lab.plant.insertion.position
    if stops:
        assert goal_mm[0] + 5.0 < reached_mm < goal_mm[0] + 8.0
    else:
        assert reached_mm == pytest.approx(goal_mm[0], abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(("entry_mm", "outcome"), [(2.0, "target"), (40.0, "refused"), (-40.0, "refused")])
def test_only_a_short_way_to_the_entry_is_driven(entry_mm: float, outcome: str) -> None:
    """A zero of the stage that is wrong by 40 mm does not drive the needle 40 mm inward."""
    lab = a_lab()
    report = run_in(lab, replace(FAST, entry_depth_mm=entry_mm, longest_mm=100.0))
    assert report.outcome == outcome, report.cause
    if outcome == "refused":
        assert lab.plant.insertion.measured == pytest.approx(0.0, abs=0.01)
