"""How long samples were on their way: what waits in a buffer does not pass for fresh."""

from __future__ import annotations

from itertools import accumulate

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.control.safety import Cause, Inputs, SafetyLimits, validate
from needleplan.control.safety._inputs import Delay
from needleplan.devices import StageSample, Stamp

ZERO_S = 123.0


def stamps(ways_s: list[float], rate: float = 1.0, every_s: float = 0.01) -> list[Stamp]:
    """Return the stamps of samples that took so long, from a device whose clock goes at a rate."""
    return [
        Stamp(round((ZERO_S + number * every_s + way_s) * 1e9), number, device_time_s=7e4 + number * every_s * rate)
        for number, way_s in enumerate(ways_s)
    ]


def late(found: list[Stamp]) -> list[float]:
    delay, times = Delay(), []
    for stamp in found:
        delay = delay.then(stamp)
        times.append(delay.late_s)
    return times


@given(st.lists(st.floats(0, 0.5), min_size=1, max_size=50))
def test_it_is_the_way_beyond_the_shortest_so_far(times_s: list[float]) -> None:
    # Samples arrive in their order: who waits holds up those behind him.
    arrivals_s = list(accumulate((0.01 * number + way_s for number, way_s in enumerate(times_s)), max))
    ways_s = [arrival_s - 0.01 * number for number, arrival_s in enumerate(arrivals_s)]
    found = late(stamps(ways_s))
    for number, way_s in enumerate(ways_s):
        slow = way_s - min(ways_s[: number + 1])
        # The shortest may have grown by 0.1 % of the time since.
        assert slow - 0.001 * (arrivals_s[number] - arrivals_s[0]) - 1e-6 <= found[number] <= slow + 1e-6
        assert found[number] >= 0


@pytest.mark.parametrize("rate", [0.9991, 1.0, 1.0009])
def test_clocks_may_go_at_different_rates(rate: float) -> None:
    assert max(late(stamps([0.002] * 10_000, rate))) < 1e-6


def test_a_clock_that_begins_anew_is_believed() -> None:
    first = stamps([0.001] * 10)
    again = [Stamp(each.received_ns + 10**9, each.sequence, device_time_s=0.01 * each.sequence) for each in first]
    assert max(late(first + again)) < 1e-6


def test_a_device_without_a_clock_is_taken_by_its_arrival() -> None:
    assert late([Stamp(number, number) for number in range(5)]) == [0.0] * 5


def test_a_sample_that_waited_does_not_pass_for_fresh() -> None:
    limits, inputs = SafetyLimits(), Inputs()
    for stamp in stamps([0.001] * 100 + [0.2] * 100):
        inputs = inputs.with_stage(StageSample(stamp, 1.0, 0.0, 0.0, False))
        causes = validate(inputs, limits, stamp.received_ns)
        assert (Cause.STAGE_SUSPECT in causes) == (stamp.sequence >= 100)
        assert (inputs.stage_known(limits, stamp.received_ns) is None) == (stamp.sequence >= 100)
