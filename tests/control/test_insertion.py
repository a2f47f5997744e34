"""The loop in the lab twin, on simulated time."""

import gc
import math
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest

from needleplan.control import (
    ExecutedStep,
    Insertion,
    InsertionOutcome,
    Listener,
    RunEventName,
    ScenarioGeometry,
)
from needleplan.control.safety import Cause, Order
from needleplan.devices import Clock, SystemClock, VirtualClock
from needleplan.errors import DeviceFault, InputError, MotionRefused
from needleplan.models import Torsion
from needleplan.planning import Action, Outcome, plan
from needleplan.simulation import Effects, SimulatedEntry
from tests.control.person import Person
from tests.control.scenes import FAST, NOISY, WIDE, a_lab, coil_of, insertion_in, run_in, small_table, station_of
from tests.estimation.registrations import known


@pytest.mark.slow
def test_a_perfect_needle_goes_where_the_plan_says() -> None:
    table, lab = small_table(), a_lab()
    report = run_in(lab)
    planned = table.path(table.best_entry().pose)
    assert planned.outcome is Outcome.TARGET
    assert report.outcome is InsertionOutcome.TARGET, report.cause
    x, y, _ = lab.plant.tip().position_mm
    assert math.dist((x, y), table.scenario.target.center_mm) == pytest.approx(report.error_mm, abs=0.05)
    assert report.beyond_rim_mm == 0
    assert report.replans == 0
    assert report.inserted_mm == pytest.approx(planned.length_mm, abs=2 * table.scenario.step_mm)
    assert report.predicted_success == pytest.approx(table.lookup(*planned.start).success)
    assert not lab.plant.moving


@pytest.mark.slow
@pytest.mark.parametrize("stops", [False, True])
def test_every_decision_is_that_of_the_table(stops: bool) -> None:
    report = run_in(a_lab(NOISY, 3), replace(FAST, stops=stops))
    assert report.outcome is InsertionOutcome.TARGET, report.cause
    scenario, table = small_table().scenario, small_table()
    for step in report.steps[:-1]:
        decision = table.lookup(*step.pose)
        assert (step.action, step.value, step.success) == (decision.action, decision.value, decision.success)
        ix, iy, heading, bevel = step.state
        assert abs(scenario.x_mm[ix] - step.pose.x_mm) <= 0.25 + 1e-9
        assert abs(scenario.y_mm[iy] - step.pose.y_mm) <= 0.25 + 1e-9
        turn = math.remainder(scenario.headings_rad[heading] - step.pose.heading_rad, 2 * math.pi)
        assert abs(turn) <= math.pi / scenario.motion.headings + 1e-9
        assert 2 * bevel - 1 == step.pose.bevel
    turns = [step for step in report.steps if step.action is Action.ROTATE]
    assert len(turns) == report.turns
    assert [step.number for step in report.steps] == list(range(len(report.steps)))
    if not stops:  # the same samples make the same decisions
        again = run_in(a_lab(NOISY, 3), replace(FAST, stops=stops))
        assert again.steps == report.steps
        assert np.array_equal(again.executed_mm, report.executed_mm)


@pytest.mark.slow
def test_it_plans_again_where_the_needle_bends_more_than_planned() -> None:
    lab = a_lab(replace(NOISY, curvature_error=0.25), 1)
    report = run_in(lab)
    names = [event.name for event in report.events]
    assert names.count(RunEventName.TABLE_SWAPPED) == report.replans >= 1
    swapped = next(event for event in report.events if event.name is RunEventName.TABLE_SWAPPED)
    asked = next(event for event in report.events if event.name is RunEventName.REPLAN_ASKED)
    assert "standard deviations" in asked.cause
    assert {step.table_digest for step in report.steps if step.number < swapped.step} == {small_table().digest}
    assert report.steps[swapped.step].table_digest == swapped.digest != small_table().digest
    assert run_in(a_lab(), replace(FAST, replan=False)).replans == 0


class Stopping(Listener):
    def __init__(self, after: int) -> None:
        self.after = after
        self.insertion: Insertion | None = None

    def step(self, step: ExecutedStep) -> None:
        if step.number == self.after and self.insertion:
            self.insertion.stop("enough")


def test_the_operator_stops_it_for_good() -> None:
    lab, listener = a_lab(), Stopping(3)
    listener.insertion = insertion_in(lab, listeners=[listener])
    report = listener.insertion.run()
    assert (report.outcome, report.cause) == (InsertionOutcome.STOPPED, "enough")
    assert len(report.steps) == 4
    lab.advance(1.0)
    depth = lab.plant.insertion.position
    lab.advance(1.0)
    assert lab.plant.insertion.position == pytest.approx(depth, abs=1e-6)


class StoppingElsewhere(Stopping):
    """Stops the run from another thread, which has ended before the loop sends its next command."""

    def step(self, step: ExecutedStep) -> None:
        if step.number == self.after and self.insertion:
            other = threading.Thread(target=self.insertion.stop, args=["enough"])
            other.start()
            other.join()


def test_a_stop_by_another_thread_is_a_stop_and_no_fault() -> None:
    listener = StoppingElsewhere(3)
    listener.insertion = insertion_in(a_lab(), listeners=[listener])
    report = listener.insertion.run()
    assert (report.outcome, report.cause) == (InsertionOutcome.STOPPED, "enough")
    assert [event.cause for event in report.events][-1] == "stopped"


@pytest.mark.slow
@pytest.mark.parametrize("how", ["pause", "retract"])
def test_only_a_person_ends_the_pause_of_a_person(how: str) -> None:
    lab = a_lab(NOISY, 3)
    person = Person(lab, 8.0, lambda guard: guard.order(Order.PAUSE, "anna") if how == "pause"
                    else guard.retract(lab.plant.insertion.position - 3.0, 1.0, "anna"))  # fmt: skip
    person.insertion = insertion_in(lab, listeners=[person])
    report = person.insertion.run()
    assert report.outcome is InsertionOutcome.TARGET, report.cause
    assert person.states == {"PAUSED"}
    first, last = person.depths_mm[0], person.depths_mm[-1]
    assert last == pytest.approx(first - 3.0, abs=0.6) if how == "retract" else abs(last - first) < 0.6
    assert max(person.depths_mm) < first + 0.6
    paused = [event for event in report.events if event.name is RunEventName.PAUSED]
    # A pause in which a person has retracted the needle ends with RETRACTED: the loop decides anew.
    ends = (RunEventName.RESUMED, RunEventName.RETRACTED)
    resumed = [event for event in report.events if event.name in ends]
    assert "ordered by a person" in [event.cause for event in paused]
    assert [event.name for event in resumed].count(RunEventName.RETRACTED) == (how == "retract")
    assert len(paused) == len(resumed)
    waited_s = [(end.time_ns - begin.time_ns) * 1e-9 for begin, end in zip(paused, resumed, strict=True)]
    assert max(waited_s) == pytest.approx(8.0, abs=0.1)


@pytest.mark.slow
def test_a_pause_of_a_person_lasts_at_most_as_long_as_a_run() -> None:
    lab = a_lab()
    person = Person(lab, 1e9, lambda guard: guard.order(Order.PAUSE, "anna"))
    person.insertion = insertion_in(lab, listeners=[person], limits=replace(WIDE, run_s=20.0))
    report = person.insertion.run()
    assert report.outcome is InsertionOutcome.FAULT
    assert "time_exceeded" in report.cause


def test_a_start_outside_of_the_table_moves_nothing() -> None:
    lab = a_lab(entry=SimulatedEntry(-5.0, 20.0, 0.0))
    report = run_in(lab)
    assert report.outcome is InsertionOutcome.REFUSED
    assert "must lie in the workspace" in report.cause
    assert lab.plant.insertion.position == 0
    assert report.steps == ()


def test_from_where_the_target_cannot_be_reached_it_does_not_begin() -> None:
    lab = a_lab(entry=SimulatedEntry(0.0, 39.0, 1.5))
    report = run_in(lab)
    assert report.outcome is InsertionOutcome.UNREACHABLE
    assert lab.plant.insertion.position == 0


def test_a_device_that_falls_silent_ends_it() -> None:
    lab = a_lab()
    lab.tracker.close()
    report = run_in(lab)
    assert report.outcome is InsertionOutcome.REFUSED
    assert "is closed" in report.cause
    assert report.events[-1].name is RunEventName.END


def test_options_name_all_their_mistakes() -> None:
    with pytest.raises(InputError, match="2 mistakes"):
        replace(FAST, velocity_mm_s=-1.0, least_success=2.0)


@pytest.mark.slow
def test_it_waits_while_the_tracker_does_not_see_its_coil() -> None:
    unseen = replace(NOISY, tracker_dropout=0.02, tracker_dropout_s=0.5)
    report = run_in(a_lab(unseen, 2))
    assert report.outcome is InsertionOutcome.TARGET, report.cause
    paused = [event for event in report.events if event.name is RunEventName.PAUSED]
    assert paused
    assert {event.cause for event in paused} <= {"pose_stale", "pose_unseen"}
    assert sum(event.name is RunEventName.RESUMED for event in report.events) == len(paused)


def test_a_tracker_too_slow_for_its_age_limit_is_refused_before_anything_moves() -> None:
    lab = a_lab()
    report = run_in(lab, limits=replace(WIDE, pose_age_s=0.02))
    assert report.outcome is InsertionOutcome.REFUSED
    assert "every 25 ms" in report.cause
    assert "safety.pose_age_s" in report.cause
    assert lab.plant.insertion.position == 0


@pytest.mark.slow
def test_a_frame_that_is_missing_costs_a_pause_and_no_more() -> None:
    """At 40 Hz the default age limit bears no missing frame: the stop must be on its way within 50 ms."""
    blinking = replace(NOISY, tracker_dropout=0.02, tracker_dropout_s=0.01)
    report = run_in(a_lab(blinking, 4), limits=replace(WIDE, pose_age_s=0.045))
    assert report.outcome is InsertionOutcome.TARGET, report.cause
    names = [event.name for event in report.events]
    assert names.count(RunEventName.PAUSED) == names.count(RunEventName.RESUMED) > 0


def test_it_ends_where_it_may_not_resume() -> None:
    unseen = replace(NOISY, tracker_dropout=0.02, tracker_dropout_s=0.5)
    report = run_in(a_lab(unseen, 2), replace(FAST, resume_s=0.0))
    assert report.outcome is InsertionOutcome.FAULT
    assert report.cause == "paused for 0 s: pose_unseen"


def test_too_much_force_stops_it_and_the_stop_is_latched() -> None:
    lab = a_lab(replace(NOISY, force_drift_n_s=0.1))
    insertion = insertion_in(lab, limits=replace(WIDE, force_n=0.3))
    report = insertion.run()
    assert report.outcome is InsertionOutcome.FAULT
    assert "force_exceeded" in report.cause
    assert 0.3 < report.largest_force_n < 0.35
    lab.advance(0.5)
    assert not lab.plant.moving
    with pytest.raises(MotionRefused, match="force_exceeded"):
        insertion.guard.insert(10.0, 1.0)
    with pytest.raises(MotionRefused, match="force_exceeded"):
        insertion.guard.order(Order.ENABLE, "somebody")


def test_a_stage_has_one_controller() -> None:
    lab = a_lab()
    first = insertion_in(lab)
    with pytest.raises(MotionRefused, match="second_commander"):
        insertion_in(lab)
    first.close()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.study) for seed in (2, 3))])
def test_a_pause_anywhere_in_a_step_is_only_a_pause(seed: int) -> None:
    """A needle that was paused just before the end of a step goes on from where it stands."""
    unseen = replace(NOISY, tracker_dropout=0.05, tracker_dropout_s=0.3)
    report = run_in(a_lab(unseen, seed), limits=replace(WIDE, run_s=60.0))
    assert report.outcome is InsertionOutcome.TARGET, report.cause
    assert any(event.name is RunEventName.PAUSED for event in report.events)
    assert report.duration_s < 60


@pytest.mark.slow
@pytest.mark.parametrize("compensated", [True, False])
def test_a_known_torsional_lag_is_compensated(compensated: bool) -> None:
    """The lag of the tip's roll is some 8 degrees at the end: known, the tip looks where it should all the same."""
    lab = a_lab(Effects(torsional_friction_n=0.25))
    torsion = Torsion(lab.plant.setup.shaft.torsional_stiffness_n_mm2, 0.25) if compensated else None
    report = run_in(lab, replace(FAST, torsion=torsion))
    assert report.turns >= 2
    lag = Torsion(1.5e4, 0.25).lag_rad(200 - report.inserted_mm, report.inserted_mm)
    off = abs(math.remainder(lab.plant.tip_roll_rad, math.pi))
    if compensated:
        assert off < 0.1 * lag
    else:
        assert off > 0.3 * lag


@pytest.mark.slow
@pytest.mark.parametrize(("clock", "real"), [(VirtualClock(), False), (SystemClock(), True)])
def test_in_real_time_neither_garbage_nor_another_thread_makes_it_wait(clock: Clock, real: bool) -> None:
    lab, usual_s = a_lab(), sys.getswitchinterval()

    def bias() -> None:
        raise DeviceFault(f"frozen: {gc.get_freeze_count() > 0}, turns: {1e3 * sys.getswitchinterval():.1f} ms")

    lab.force_sensor.bias = bias  # type: ignore[method-assign]
    station = replace(station_of(lab), clock=clock)
    report = Insertion(small_table(), station, FAST, registration=known()).run()
    turns_ms = 0.5 if real else 1e3 * usual_s
    assert (report.outcome, report.cause) == (InsertionOutcome.REFUSED, f"frozen: {real}, turns: {turns_ms:.1f} ms")
    assert gc.get_freeze_count() == 0
    assert sys.getswitchinterval() == usual_s


@pytest.mark.slow
def test_an_obstacle_is_noticed_during_a_step_and_ends_the_run_there() -> None:
    """The table knows nothing of the vessel that the needle meets."""
    lab = a_lab(entry=SimulatedEntry(0.0, 19.0, 0.0))
    table = plan(replace(small_table().scenario, obstacles=()))
    insertion = Insertion(
        table, station_of(lab), FAST, registration=coil_of(lab), limits=WIDE, accepted_limits="a fast lab"
    )
    insertion._guidance.scene = ScenarioGeometry(small_table().scenario)
    report = insertion.run()
    assert report.outcome is InsertionOutcome.COLLISION, report.cause
    assert "in vessel" in report.cause
    lab.advance(0.5)
    x, _, _ = lab.plant.tip().position_mm
    assert 22.0 < x < 23.5
    assert Cause.IN_OBSTACLE in insertion.guard.state.latched
    assert report.steps[-1].pose.x_mm < 22.0 < x
