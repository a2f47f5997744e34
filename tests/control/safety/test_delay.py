"""How long samples were on their way: what waits in a buffer does not pass for fresh."""

from itertools import accumulate

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.control.safety import Cause, Inputs, SafetyLimits, validate
from needleplan.control.safety._inputs import Delay
from needleplan.devices import ForceSample, PoseSample, Sample, StageSample, Stamp

ZERO_S = 123.0
CLOCK_DRIFT = 100e-6  # of the guard: two crystals of 50 ppm


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
        # The shortest may have grown by the drift of the time since.
        assert slow - CLOCK_DRIFT * (arrivals_s[number] - arrivals_s[0]) - 1e-6 <= found[number] <= slow + 1e-6
        assert found[number] >= 0


@pytest.mark.parametrize("rate", [1 - CLOCK_DRIFT, 1.0, 1 + CLOCK_DRIFT])
def test_a_crystal_that_drifts_for_ten_minutes_is_no_delay(rate: float) -> None:
    assert max(late(stamps([0.002] * 60_000, rate))) < 1e-5


@pytest.mark.parametrize(("growth", "within_s"), [(0.05, 0.61), (0.01, 3.1), (0.001, 34.0)])
def test_a_delay_that_grows_is_found_by_its_sum(growth: float, within_s: float) -> None:
    """The limit of 30 ms is reached after 30 ms / (growth - drift)."""
    times_s = [0.01 * number for number in range(6000)]
    found = late(stamps([0.002 + growth * time_s for time_s in times_s]))
    first = next(number for number, late_s in enumerate(found) if late_s > 0.03)
    assert times_s[first] == pytest.approx(0.03 / (growth - CLOCK_DRIFT), abs=0.02)
    assert times_s[first] <= within_s


def test_a_clock_that_begins_anew_is_believed() -> None:
    first = stamps([0.001] * 10)
    again = [Stamp(each.received_ns + 10**9, each.sequence, device_time_s=0.01 * each.sequence) for each in first]
    assert max(late(first + again)) < 1e-6


def test_a_device_without_a_clock_is_taken_by_its_arrival() -> None:
    assert late([Stamp(number, number) for number in range(5)]) == [0.0] * 5


def sample(source: str, stamp: Stamp) -> Sample:
    match source:
        case "force":
            return ForceSample(stamp, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
        case "pose":
            return PoseSample(stamp, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.1)
    return StageSample(stamp, 1.0, 0.0, 0.0, False)


@pytest.mark.parametrize(
    ("source", "cause"), [("force", Cause.FORCE_STALE), ("pose", Cause.POSE_STALE), ("stage", Cause.STAGE_STALE)]
)
def test_a_sample_that_waited_does_not_pass_for_fresh(source: str, cause: Cause) -> None:
    limits, inputs = SafetyLimits(), Inputs()
    for stamp in stamps([0.001] * 100 + [0.2] * 100):
        inputs = inputs.then(sample(source, stamp), None)
        causes = validate(inputs, limits, stamp.received_ns)
        assert (cause in causes) == (stamp.sequence >= 100)
        if source == "stage":
            assert (inputs.stage_known(limits, stamp.received_ns) is None) == (stamp.sequence >= 100)


@pytest.mark.parametrize("source", ["force", "pose", "stage"])
def test_jitter_is_no_age(source: str) -> None:
    """Samples that wait up to 10 ms each are fresh, however long it goes on."""
    limits, inputs = SafetyLimits(), Inputs()
    for stamp in stamps([0.002 + 0.002 * (number % 5) for number in range(3000)], every_s=0.01):
        inputs = inputs.then(sample(source, stamp), None)
        assert not {Cause.FORCE_STALE, Cause.POSE_STALE, Cause.STAGE_STALE}.intersection(
            validate(inputs, limits, stamp.received_ns)
        ).intersection({Cause(f"{source}_stale")})
