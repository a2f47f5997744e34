"""Faults 18 to 27 of a tracker, as far as OpenIGTLink has them, on a virtual clock."""

import math
from dataclasses import replace

import pytest

from needleplan.devices import Health, PoseSample
from needleplan.devices.igtl import IgtlPoseLimits, IgtlTracker, PoseKind
from needleplan.devices.igtl.poses import ToolKind
from needleplan.errors import DeviceFault, LinkClosed
from tests.devices.igtl.bench import TIP, Bench, needle


@pytest.fixture(params=PoseKind)
def bench(request: pytest.FixtureRequest) -> Bench:
    return Bench(request.param)


def next_of(tracker: IgtlTracker, timeout_s: float = 0.4) -> PoseSample:
    sample = tracker.read(timeout_s)
    assert sample is not None
    return sample


def settled(bench: Bench) -> IgtlTracker:
    tracker = bench.tracker()
    assert [next_of(tracker).health for _ in range(3)] == [Health.GOOD] * 3
    return tracker


@pytest.fixture
def tracker(bench: Bench) -> IgtlTracker:
    return settled(bench)


def while_it_lasts(tracker: IgtlTracker) -> None:
    for _ in range(400):
        tracker.read(0.05)


def fault_of(tracker: IgtlTracker, cause: str) -> None:
    """Read until the tracker gives up, and see that it stays given up."""
    with pytest.raises(DeviceFault, match=cause):
        while_it_lasts(tracker)
    with pytest.raises(DeviceFault, match=cause):
        tracker.read(0)


def test_18_damaged_messages_are_dropped_and_counted(tracker: IgtlTracker, bench: Bench) -> None:
    bench.faults.damage = 2
    assert next_of(tracker).health is Health.GOOD
    damaged = tracker.counts.damaged
    assert 1 <= damaged <= 2
    assert tracker.counts.lost == (2 if bench.kind.holds_tools else 1)


def test_18_damage_without_end_is_a_fault(tracker: IgtlTracker, bench: Bench) -> None:
    bench.faults.damage = 10**6
    fault_of(tracker, "10 damaged messages in succession")


def test_19_a_message_that_is_cut_short_costs_no_other(tracker: IgtlTracker, bench: Bench) -> None:
    before = next_of(tracker).stamp.sequence
    bench.faults.cut = 1
    bench.faults.noise_before = b"\x00\x01TRANSFORM and other noise"
    after = next_of(tracker)
    assert after.health is Health.GOOD
    assert after.stamp.sequence == before + 2
    assert after.stamp.lost == 1


def test_19_a_length_that_nobody_has_costs_one_message(tracker: IgtlTracker, bench: Bench) -> None:
    bench.faults.absurd = 1
    after = next_of(tracker)
    assert after.stamp.lost == 1
    assert tracker.counts.damaged == 1


def test_20_another_protocol_is_a_fault_that_says_so() -> None:
    bench = Bench()
    tracker = settled(bench)
    bench.faults.mute = True
    for _ in range(30):
        bench.link.say(b"HTTP/1.1 400 Bad Request\r\n\r\n")
    fault_of(tracker, r"no new TRANSFORM 'NeedleToTracker' for 0.\d+ s")


def test_21_a_coil_that_is_left_out_of_a_frame_is_missing_and_comes_back() -> None:
    bench = Bench(PoseKind.TDATA)
    tracker = settled(bench)
    bench.tip.status = "OUT_OF_VIEW"
    sample = next_of(tracker)
    assert (sample.health, sample.notes) == (Health.MISSING, ("not seen",))
    assert all(map(math.isnan, (*sample.position_mm, *sample.quaternion)))
    bench.tip.status = "OK"
    assert next_of(tracker).health is Health.GOOD


def test_21_a_coil_that_is_left_out_as_its_own_message_ends_in_a_fault() -> None:
    bench = Bench()
    tracker = settled(bench)
    bench.tip.status = "MISSING"
    fault_of(tracker, "no new TRANSFORM 'NeedleToTracker' for .* Some servers omit coils that are not visible")
    bench.tip.status = "OK"
    tracker.start()
    assert next_of(tracker).health is Health.GOOD


@pytest.mark.parametrize("status", ["OUT_OF_VOLUME", "MISSING", "INVALID"])
def test_22_numbers_that_the_server_does_not_vouch_for_are_none(bench: Bench, status: str) -> None:
    bench.device.valid_only = False
    tracker = settled(bench)
    bench.tip.status = status
    sample = next_of(tracker)
    assert (sample.health, sample.notes) == (Health.MISSING, (f"not seen: {status}",))
    assert math.isnan(sample.position_mm[0])


@pytest.mark.parametrize("kind", [PoseKind.TRANSFORM, PoseKind.POSITION])
def test_22_the_identity_that_stands_for_nothing_is_known_without_a_status(kind: PoseKind) -> None:
    bench = Bench(kind)
    bench.device.valid_only, bench.device.version = False, 1
    tracker = settled(bench)
    bench.tip.status = "MISSING"
    sample = next_of(tracker)
    assert (sample.health, sample.notes) == (Health.MISSING, ("not seen, or exactly at the origin",))


def test_23_a_repeated_frame_is_not_a_sample_and_ends_in_a_fault(tracker: IgtlTracker, bench: Bench) -> None:
    bench.faults.freeze = True
    began_ns = bench.clock.now_ns()
    assert tracker.read(0.2) is None
    assert tracker.counts.repeated == 8
    fault_of(tracker, "for 0.5 s; received 20 repeated")
    assert bench.clock.now_ns() - began_ns < 0.6e9


def test_23_skipped_frames_are_counted(tracker: IgtlTracker, bench: Bench) -> None:
    bench.faults.skip = 3
    sample = next_of(tracker)
    assert sample.stamp.lost == 3
    assert tracker.counts.lost == 3


def test_23_without_a_rate_nothing_is_said_to_be_lost(bench: Bench) -> None:
    bench.rate_hz = 0
    tracker = settled(bench)
    bench.faults.skip = 3
    assert next_of(tracker).stamp.lost == 0


def test_23_a_frame_without_time_may_be_any_frame(bench: Bench) -> None:
    bench.faults.timeless = True
    sample = next_of(bench.tracker())
    assert sample.health is Health.SUSPECT
    assert "without a time" in sample.notes[0]


def test_24_what_is_no_rotation_is_suspect_or_missing(tracker: IgtlTracker, bench: Bench) -> None:
    bench.faults.stretch = 1.02
    sample = next_of(tracker)
    assert sample.health is Health.SUSPECT
    assert "not a rotation" in sample.notes[0]
    assert math.hypot(*sample.quaternion) == pytest.approx(1)
    bench.faults.stretch = math.nan
    assert next_of(tracker).health is Health.MISSING
    bench.faults.stretch = 1.0
    assert next_of(tracker).health is Health.GOOD


def test_24_a_flipped_sign_is_turned_back(tracker: IgtlTracker, bench: Bench) -> None:
    before = next_of(tracker).quaternion
    bench.faults.flip = True
    after = next_of(tracker)
    assert after.health is Health.GOOD
    assert math.fsum(map(float.__mul__, before, after.quaternion)) > 0.99


def test_24_another_tool_under_the_name_is_suspect(tracker: IgtlTracker, bench: Bench) -> None:
    bench.tip.pose = bench.device.tools[1].pose
    sample = next_of(tracker)
    assert sample.health is Health.SUSPECT
    assert "a step of" in sample.notes[0]


def test_24_two_tools_of_one_name_are_a_fault() -> None:
    bench = Bench(PoseKind.TDATA)
    tracker = settled(bench)
    bench.device.tools[1].name = TIP
    fault_of(tracker, "2 tools are called 'NeedleToTracker'")


def test_a_tool_without_orientation_is_suspect() -> None:
    bench = Bench(PoseKind.QTDATA)
    tracker = settled(bench)
    bench.tip.kind = ToolKind.POSITION_ONLY
    sample = next_of(tracker)
    assert sample.health is Health.SUSPECT
    assert "without orientation" in sample.notes[0]


def test_25_a_server_whose_time_goes_back_is_a_fault(tracker: IgtlTracker, bench: Bench) -> None:
    bench.faults.time_step_s = -5.0
    fault_of(tracker, "time went back by")


def test_26_frames_that_lay_in_a_queue_are_suspect_and_the_next_are_not(bench: Bench) -> None:
    bench.limits = IgtlPoseLimits(late_s=0.11)
    tracker = settled(bench)
    bench.clock.sleep(1.0)
    samples = [next_of(tracker, 0.0) for _ in range(40)]
    assert [each.stamp.lost for each in samples] == [0] * 40
    assert samples[0].health is Health.SUSPECT
    assert "s late" in samples[0].notes[0]
    assert samples[-1].health is Health.GOOD
    suspect = [each for each in samples if each.health is Health.SUSPECT]
    # What is older than the limit, of one second at 40 Hz.
    assert len(suspect) == 35
    assert next_of(tracker).health is Health.GOOD


def test_26_silence_is_a_fault_in_time(tracker: IgtlTracker, bench: Bench) -> None:
    began_ns = bench.clock.now_ns()
    bench.faults.mute = True
    fault_of(tracker, "for 0.5 s")
    assert bench.clock.now_ns() - began_ns < 0.6e9


def test_26_waiting_ends_at_the_deadline(tracker: IgtlTracker, bench: Bench) -> None:
    bench.faults.mute = True
    began_ns = bench.clock.now_ns()
    assert tracker.read(0.1) is None
    assert bench.clock.now_ns() - began_ns == pytest.approx(0.1e9, abs=1e6)


def test_27_a_cable_that_is_out_closes_the_link(tracker: IgtlTracker, bench: Bench) -> None:
    bench.link.unplug()
    for _ in range(2):
        with pytest.raises(LinkClosed):
            tracker.read(0.1)


def test_limits_are_told() -> None:
    bench = Bench(limits=replace(IgtlPoseLimits(), speed_mm_s=1.0))
    tracker = bench.tracker()
    next_of(tracker)
    assert next_of(tracker).notes[0].startswith("a step of 0.05 mm")
    assert needle(1.0)[0][0] - needle(0.0)[0][0] == 2.0
