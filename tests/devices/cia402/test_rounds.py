"""Rounds of questions on a virtual clock, with answers that come late."""

from typing import cast

from needleplan.devices import VirtualClock
from needleplan.devices.cia402._axes import Cia402Axis, DriveTiming, Rounds
from needleplan.devices.cia402._drive import CanBus


class _Bus:
    def __init__(self) -> None:
        self.clock = VirtualClock(10**9)
        self.syncs_ns: list[int] = []

    def sync(self) -> None:
        self.syncs_ns.append(self.clock.now_ns())


class _Axis:
    name, complete, moving = "axis", False, False
    position = velocity = 0.0
    received_ns = 0

    def expect(self) -> None:
        self.complete = False


def test_a_late_answer_is_as_old_as_the_first_question_that_is_open() -> None:
    """As the answer to the second SYNC it would make a drive that moved through a pause of ours seem to have jumped."""
    bus, axes, timing = _Bus(), [_Axis(), _Axis()], DriveTiming()
    rounds = Rounds(cast("CanBus", bus), cast("list[Cia402Axis]", axes), timing)
    rounds.ask()
    bus.clock.advance(5 * timing.sync_s)
    rounds.ask()
    first_ns, second_ns = bus.syncs_ns
    assert rounds.asked_ns == second_ns
    assert rounds.earliest_ns == first_ns
    for axis in axes:
        axis.complete = True
    sample = rounds.sample()
    assert sample is not None
    assert sample.stamp.lost == 1
    assert rounds.earliest_ns == second_ns
