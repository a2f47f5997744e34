"""Faults 18 to 27 of the device layer: each ends in the documented state, with its cause."""

import math

import pytest

from needleplan.devices import Health, PoseSample
from needleplan.devices.ndi import NdiTracker, SimulatedTool
from needleplan.devices.ndi.commands import encode_text
from needleplan.devices.ndi.frames import NdiVisibility
from needleplan.errors import ConfigurationError, DeviceFault, LinkClosed
from tests.devices.ndi.bench import TIP, Bench, needle


@pytest.fixture(params=[False, True], ids=["bx", "tx"])
def bench(request: pytest.FixtureRequest) -> Bench:
    return Bench(text=request.param)


def next_of(tracker: NdiTracker, timeout_s: float = 0.5) -> PoseSample:
    sample = tracker.read(timeout_s)
    assert sample is not None
    return sample


def settled(bench: Bench) -> NdiTracker:
    tracker = bench.tracker()
    assert [next_of(tracker).health for _ in range(3)] == [Health.GOOD] * 3
    return tracker


@pytest.fixture
def tracker(bench: Bench) -> NdiTracker:
    return settled(bench)


def fault_of(tracker: NdiTracker, cause: str, timeout_s: float = 0.05, within: int = 400) -> None:
    """Read until the tracker gives up, and see that it stays given up."""
    try:
        for _ in range(within):
            tracker.read(timeout_s)
    except DeviceFault as fault:
        assert cause in str(fault)
    with pytest.raises(DeviceFault, match=cause):
        tracker.read(0)


def test_the_start_is_the_sequence_of_the_guide(bench: Bench) -> None:
    bench.tracker()
    assert bench.device.commands[:10] == [
        "INIT:", "PHSR:01", "PHSR:02", "PINIT:0A", "PINIT:0B", "PHSR:02", "PHSR:03", "PENA:0AD", "PENA:0BD", "PHSR:04",
    ]  # fmt: skip
    assert bench.device.commands[-1] == "TSTART:"


def test_a_tracker_that_was_left_tracking_starts(bench: Bench) -> None:
    bench.device.tracking = True
    assert next_of(bench.tracker()).health is Health.GOOD


@pytest.mark.parametrize(("tool", "rule"), [("", "must be given"), ("12345678", "serial number of one tool")])
def test_a_tool_that_is_not_there_is_refused(tool: str, rule: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"{rule}.*34801403 \(handle 0A\)"):
        Bench().tracker(tool)


def test_18_damaged_replies_are_asked_for_again(tracker: NdiTracker, bench: Bench) -> None:
    bench.faults.damage = 3
    began_ns = bench.clock.now_ns()
    assert next_of(tracker).health is Health.GOOD
    assert tracker.counts.damaged == 3
    assert bench.clock.now_ns() - began_ns < 0.7e9


def test_18_damage_without_end_is_a_fault(tracker: NdiTracker, bench: Bench) -> None:
    bench.faults.damage = 10**6
    fault_of(tracker, "10 damaged replies in succession")


def test_19_a_reply_that_is_cut_short_is_given_up_and_the_next_is_found(tracker: NdiTracker, bench: Bench) -> None:
    bench.faults.cut = 2
    assert next_of(tracker, 1.0).health is Health.GOOD
    assert tracker.counts.damaged == 2
    bench.faults.noise_before = b"\xc4\xa5\x00\xffnoise"
    assert next_of(tracker, 1.0).health is Health.GOOD


def test_20_a_transient_error_is_asked_again_and_another_is_a_fault(tracker: NdiTracker, bench: Bench) -> None:
    bench.faults.error = 0x04
    assert next_of(tracker).health is Health.GOOD
    assert tracker.counts.refused == 1
    bench.faults.error = 0x0C
    fault_of(tracker, "error 0C, not possible in this mode")


def test_21_a_coil_that_is_not_seen_is_missing_and_comes_back(tracker: NdiTracker, bench: Bench) -> None:
    bench.tip.visibility = NdiVisibility.MISSING
    sample = next_of(tracker)
    assert (sample.health, sample.notes) == (Health.MISSING, ("not seen",))
    assert all(map(math.isnan, (*sample.position_mm, *sample.quaternion)))
    bench.tip.visibility = NdiVisibility.VALID
    assert next_of(tracker).health is Health.GOOD


@pytest.mark.parametrize("seen", [NdiVisibility.DISABLED, NdiVisibility.UNOCCUPIED])
def test_21_a_tool_that_is_no_longer_tracked_is_a_fault(seen: NdiVisibility) -> None:
    bench = Bench(text=True)
    tracker = settled(bench)
    bench.tip.visibility = seen
    fault_of(tracker, f"is {seen} in the middle")


def test_21_a_tool_that_is_gone_from_the_reply_is_a_fault(tracker: NdiTracker, bench: Bench) -> None:
    bench.tip.enabled = False
    fault_of(tracker, "handle 0A occurs 0 times")


@pytest.mark.parametrize(
    ("bits", "error_mm", "note"),
    [(0x40, 0.05, "out of the volume"), (0x80, 0.05, "partly out"), (0x1000, 0.05, "port status 00001000"),
     (0, 2.5, "fit error 2.5 mm")],
)  # fmt: skip
def test_22_plausible_numbers_that_the_device_doubts_are_suspect(
    tracker: NdiTracker, bench: Bench, bits: int, error_mm: float, note: str
) -> None:
    bench.tip.port_bits, bench.tip.error_mm = bits, error_mm
    sample = next_of(tracker)
    assert sample.health is Health.SUSPECT
    assert note in sample.notes[0]


def test_23_a_repeated_frame_is_not_a_sample_and_ends_in_a_fault(tracker: NdiTracker, bench: Bench) -> None:
    bench.faults.freeze = True
    began_ns = bench.clock.now_ns()
    assert tracker.read(0.2) is None
    assert tracker.counts.repeated > 10
    fault_of(tracker, "no new frame for 0.5")
    assert bench.clock.now_ns() - began_ns < 0.6e9


def test_23_skipped_frames_are_counted_with_the_sample_after_them(tracker: NdiTracker, bench: Bench) -> None:
    bench.clock.advance(0.1)
    assert next_of(tracker).stamp.lost == 3
    assert tracker.counts.lost == 3


def test_23_frame_numbers_wrap(bench: Bench) -> None:
    bench.device.first_frame = 2**32 - 3
    tracker = bench.tracker()
    samples = [next_of(tracker) for _ in range(6)]
    assert [each.stamp.sequence for each in samples] == [2**32 - 3, 2**32 - 2, 2**32 - 1, 0, 1, 2]
    assert {each.stamp.lost for each in samples} == {0}


def test_23_a_frame_number_that_goes_back_is_a_restart(bench: Bench) -> None:
    bench.device.first_frame = 5000
    tracker = settled(bench)
    bench.device.first_frame = 1
    fault_of(tracker, "went back")


def test_24_a_quaternion_that_is_not_one_is_suspect_and_worse_is_no_pose(tracker: NdiTracker, bench: Bench) -> None:
    bench.tip.pose = lambda time_s: (tuple(0.9 * each for each in needle(time_s)[0]), needle(time_s)[1])  # type: ignore[return-value]
    sample = next_of(tracker)
    assert (sample.health, sample.notes) == (Health.SUSPECT, ("quaternion of length 0.9",))
    assert math.hypot(*sample.quaternion) == pytest.approx(1)
    bench.tip.pose = lambda time_s: ((0, 0, 0, 0), needle(time_s)[1])
    sample = next_of(tracker)
    assert (sample.health, sample.notes[0]) == (Health.MISSING, "not a pose")


def test_24_infinite_numbers_are_no_pose() -> None:
    bench = Bench()
    tracker = settled(bench)
    bench.tip.pose = lambda time_s: (needle(time_s)[0], (math.nan, math.inf, -3.7e28))
    assert next_of(tracker).health is Health.MISSING


def test_24_the_sign_of_the_quaternion_does_not_flip(tracker: NdiTracker, bench: Bench) -> None:
    bench.tip.pose = lambda time_s: (tuple(-each for each in needle(time_s)[0]), needle(time_s)[1])  # type: ignore[return-value]
    sample = next_of(tracker)
    assert sample.health is Health.GOOD
    assert sample.quaternion[0] > 0.99


def test_24_a_handle_that_has_gone_to_another_tool(tracker: NdiTracker, bench: Bench) -> None:
    first, second = bench.device.tools
    first.handle, second.handle = second.handle, first.handle
    sample = next_of(tracker)
    assert sample.health is Health.SUSPECT
    assert "a step of" in sample.notes[0]
    bench.faults.system_status = 0x80
    fault_of(tracker, "is it the same tool")


def test_24_a_handle_that_comes_twice_is_a_fault(tracker: NdiTracker, bench: Bench) -> None:
    bench.device.tools = [*bench.device.tools, SimulatedTool(TIP, needle, initialised=True, enabled=True)]
    fault_of(tracker, "handle 0A occurs 2 times")


def test_25_a_device_that_resets_itself_is_a_fault(tracker: NdiTracker, bench: Bench) -> None:
    bench.link.say(bench.device.reset())
    bench.clock.advance(0.01)
    fault_of(tracker, "it has reset itself")


def test_25_a_reset_that_goes_unseen_is_a_fault_of_the_next_reply(tracker: NdiTracker, bench: Bench) -> None:
    bench.device.reset()
    fault_of(tracker, "not possible in this mode")
    tracker.start()
    assert next_of(tracker).health is Health.GOOD


def test_26_a_slow_reply_is_waited_for_and_its_age_is_told(tracker: NdiTracker, bench: Bench) -> None:
    bench.clock.advance(0.03)
    bench.faults.delay_s = 1.0
    asked = len(bench.device.commands)
    assert [tracker.read(0.3) for _ in range(3)] == [None] * 3
    bench.faults.delay_s = 0
    sample = next_of(tracker)
    assert (sample.health, sample.notes) == (Health.SUSPECT, ("the reply took 1 s",))
    assert len(bench.device.commands) == asked + 1
    assert next_of(tracker).health is Health.GOOD


def test_26_a_slow_reply_with_the_last_frame_again_is_no_stop(tracker: NdiTracker, bench: Bench) -> None:
    repeated = tracker.counts.repeated
    bench.faults.delay_s = 1.0
    assert tracker.read(0.9) is None
    bench.faults.delay_s = 0
    assert next_of(tracker).health is Health.GOOD
    assert tracker.counts.repeated == repeated + 1


def test_26_no_reply_at_all_is_a_fault_after_twelve_seconds(tracker: NdiTracker, bench: Bench) -> None:
    bench.faults.mute = True
    began_ns = bench.clock.now_ns()
    fault_of(tracker, "no reply to [BT]X for 12 s".replace("[BT]", "T" if bench.text else "B"))
    assert bench.clock.now_ns() - began_ns == pytest.approx(12e9, rel=0.02)


def test_26_a_late_answer_to_a_damaged_question_is_not_taken_for_the_next(tracker: NdiTracker, bench: Bench) -> None:
    bench.link.say(encode_text("OKAY"))
    bench.clock.advance(0.01)
    assert next_of(tracker).health is Health.GOOD
    assert tracker.counts.damaged == 0


def test_27_a_cable_that_is_out_closes_the_link(tracker: NdiTracker, bench: Bench) -> None:
    bench.link.unplug()
    with pytest.raises(LinkClosed):
        tracker.read(0.1)
    tracker.close()


@pytest.mark.parametrize(("status", "note"), [(0x01, "synchronisation"), (0x02, "infrared"), (0x08, "recoverable")])
def test_what_the_system_doubts_is_suspect(tracker: NdiTracker, bench: Bench, status: int, note: str) -> None:
    bench.faults.system_status = status
    sample = next_of(tracker)
    assert sample.health is Health.SUSPECT
    assert note in sample.notes[0]


def test_a_hardware_failure_is_a_fault(tracker: NdiTracker, bench: Bench) -> None:
    bench.faults.system_status = 0x10
    fault_of(tracker, "hardware failure")
