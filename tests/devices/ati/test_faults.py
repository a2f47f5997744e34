"""Faults 1 to 17 of the device layer: each ends in the documented state, with its cause."""

import random
from collections.abc import Callable

import pytest

from needleplan.devices import ForceSample, Health
from needleplan.devices.ati import ForceLimits, NetFt
from needleplan.devices.ati.rdt import RdtCommand, encode_request
from needleplan.errors import ConfigurationError, DeviceFault
from tests.devices.ati.bench import Bench


def next_of(sensor: NetFt) -> ForceSample:
    sample = sensor.read(0.05)
    assert sample is not None
    return sample


@pytest.fixture
def bench() -> Bench:
    return Bench()


def settled(bench: Bench) -> NetFt:
    sensor = bench.sensor()
    assert [next_of(sensor).health for _ in range(5)] == [Health.GOOD] * 5
    return sensor


@pytest.fixture
def sensor(bench: Bench) -> NetFt:
    return settled(bench)


def fault_of(sensor: NetFt, cause: str, within: int = 60) -> int:
    """Read until the sensor gives up, see that it stays given up, and return how many samples came before."""
    samples = 0
    try:
        while samples <= within:
            samples += sensor.read(0.02) is not None
    except DeviceFault as fault:
        assert cause in str(fault)
    with pytest.raises(DeviceFault, match=cause):
        sensor.read(0)
    return samples


def test_01_no_reply_at_start(bench: Bench) -> None:
    bench.box.faults.silent = True
    with pytest.raises(DeviceFault, match="no record within"):
        bench.sensor()
    assert bench.clock.now_ns() == pytest.approx(0.9e9, rel=0.05)


def test_02_the_stream_stops(bench: Bench, sensor: NetFt) -> None:
    bench.box.faults.silent = True
    began_ns = bench.clock.now_ns()
    fault_of(sensor, "silent for 0.1")
    assert bench.clock.now_ns() - began_ns <= 0.105e9
    bench.box.faults.silent = False
    sensor.start()
    assert next_of(sensor).stamp.sequence == 1


def test_03_lost_datagrams_are_counted_with_the_sample_after_them(bench: Bench, sensor: NetFt) -> None:
    bench.box.faults.lose = 3
    assert next_of(sensor).stamp.lost == 3
    assert next_of(sensor).stamp.lost == 0
    assert sensor.counts.lost == 3


def test_04_a_duplicate_comes_once(bench: Bench, sensor: NetFt) -> None:
    bench.box.faults.duplicate = 2
    assert [next_of(sensor).stamp.sequence for _ in range(4)] == [6, 7, 8, 9]
    assert sensor.counts.duplicates == 2


def test_05_a_late_datagram_is_dropped_and_counted(bench: Bench, sensor: NetFt) -> None:
    bench.box.faults.reorder = 1
    assert [next_of(sensor).stamp.sequence for _ in range(3)] == [7, 8, 9]
    assert (sensor.counts.lost, sensor.counts.late, sensor.counts.duplicates) == (1, 1, 0)


def test_06_the_sequence_wraps(bench: Bench) -> None:
    bench.box.before_first = 2**32 - 3
    sensor = bench.sensor()
    sequences = [next_of(sensor) for _ in range(5)]
    assert [each.stamp.sequence for each in sequences] == [2**32 - 2, 2**32 - 1, 0, 1, 2]
    assert {each.stamp.lost for each in sequences} == {0}


def test_07_a_box_that_no_longer_measures(bench: Bench, sensor: NetFt) -> None:
    bench.box.faults.freeze = True
    first = next_of(sensor)
    assert (first.health, first.notes) == (Health.SUSPECT, ("no new measurement",))
    assert fault_of(sensor, "has not measured for 10 records") == 8


def test_08_after_a_restart_a_new_session_begins_without_a_bias(bench: Bench, sensor: NetFt) -> None:
    sensor.bias()
    bench.box.reboot()
    sensor.start()
    assert max(map(abs, next_of(sensor).force_n)) > 1.5  # the box has forgotten its bias
    sensor.bias()
    assert max(map(abs, next_of(sensor).force_n)) < 0.1


def test_08_a_box_that_was_restarted_has_lost_its_bias(bench: Bench, sensor: NetFt) -> None:
    client = bench.box.client
    bench.box.ft_sequence += 3_000_000_000
    sensor.start()
    next_of(sensor)
    bench.box.reboot()
    bench.box.client = client
    fault_of(sensor, "bias is lost")


def test_08b_a_stream_that_somebody_starts_again_is_a_fault(bench: Bench, sensor: NetFt) -> None:
    bench.link.send(encode_request(RdtCommand.START))
    assert fault_of(sensor, "started again, but not by this program") == 0
    sensor.start()
    assert next_of(sensor).health is Health.GOOD


def test_08c_a_stream_that_we_start_twice_may_begin_twice(bench: Bench, sensor: NetFt) -> None:
    bench.box.faults.lose = 65  # more than the first start request waits for
    sensor.start()
    bench.box.request(encode_request(RdtCommand.START), bench.box.client)  # type: ignore[arg-type]
    notes = [next_of(sensor).notes for _ in range(5)]
    assert notes.count(("the stream was restarted",)) == 1


def test_09_garbage_is_counted_and_a_storm_of_it_is_a_fault(bench: Bench, sensor: NetFt) -> None:
    noise = random.Random(3)
    bench.box.faults.instead = [b"", b"x", b"y" * 35, b"z" * 37, bytes(36 * 41), noise.randbytes(36)]
    assert next_of(sensor).stamp.sequence == 6
    assert sensor.counts.malformed == 5  # an empty datagram is none
    bench.box.faults.instead = [noise.randbytes(36) for _ in range(25)] + [b"robot"] * 25
    fault_of(sensor, "50 datagrams in succession")


@pytest.mark.parametrize(
    ("status", "note"), [(0x8002_0000, "saturated"), (0x0002_0000, "saturated"), (0x8001_0000, "threshold")]
)
def test_11_and_12_saturation_and_the_latched_threshold_make_samples_suspect(
    bench: Bench, sensor: NetFt, status: int, note: str
) -> None:
    bench.box.faults.status = status
    sample = next_of(sensor)
    assert sample.health is Health.SUSPECT
    assert note in sample.notes[0]
    bench.box.faults.status = 0
    assert next_of(sensor).health is Health.GOOD


def test_12_the_latched_threshold_stays_until_it_is_reset(bench: Bench, sensor: NetFt) -> None:
    bench.box.exceed_threshold()
    assert {next_of(sensor).health for _ in range(5)} == {Health.SUSPECT}
    sensor.reset_latch()
    assert next_of(sensor).health is Health.GOOD


def test_13_any_other_status_is_a_fault_that_says_what(bench: Bench, sensor: NetFt) -> None:
    bench.box.faults.status = 0x8800_0004
    fault_of(sensor, r"0x88000004: temperature, serial link")


@pytest.mark.parametrize(
    ("key", "value"),
    [("force_unit", "apples"), ("torque_unit", ""), ("counts_per_force", 0), ("counts_per_torque", -1)],
)
def test_14_a_configuration_that_cannot_be_used_is_refused(bench: Bench, key: str, value: object) -> None:
    setattr(bench.box.settings, key, value)
    with pytest.raises(ConfigurationError, match="must be"):
        bench.sensor()


def test_14_a_configuration_that_changes_is_a_fault(bench: Bench, sensor: NetFt) -> None:
    sensor.check_configuration()
    bench.box.settings.force_unit, bench.box.settings.counts_per_force = "lbf", 1
    with pytest.raises(DeviceFault, match="has changed"):
        sensor.check_configuration()
    fault_of(sensor, "has changed")
    sensor.start()
    assert next_of(sensor).force_n[1] == pytest.approx(-2, abs=4.45)


def test_15_a_second_client_takes_the_stream(bench: Bench, sensor: NetFt) -> None:
    bench.box.request(encode_request(RdtCommand.START), ("10.0.0.7", 4000))
    fault_of(sensor, "another client")


def test_16_a_value_that_does_not_move(bench: Bench) -> None:
    bench.wrench.noise_n = 0
    sensor = bench.sensor()
    health = [next_of(sensor).health for _ in range(51)]
    assert health == [Health.GOOD] * 49 + [Health.SUSPECT] * 2


@pytest.mark.parametrize(
    ("extra_n", "note"), [(12.0, "a step of"), (60.0, "more than 50 N"), (1e6, "end of their range")]
)
def test_16_a_wrench_beyond_physics(bench: Bench, sensor: NetFt, extra_n: float, note: str) -> None:
    bench.wrench.extra_n = extra_n
    sample = next_of(sensor)
    assert sample.health is Health.SUSPECT
    assert note in " ".join(sample.notes)


def test_17_a_bias_under_load_is_refused(bench: Bench, sensor: NetFt) -> None:
    sensor.bias()
    assert next_of(sensor).force_n == pytest.approx((0, 0, 0), abs=0.02)
    bench.wrench.extra_n = 2
    with pytest.raises(DeviceFault, match="under load"):
        sensor.bias()
    assert next_of(sensor).force_n[0] == pytest.approx(2, abs=0.02)


def test_17_a_bias_in_motion_is_refused(bench: Bench, sensor: NetFt) -> None:
    bench.wrench.noise_n = 0.5
    with pytest.raises(DeviceFault, match="not steady"):
        sensor.bias()


def test_17_a_bias_that_the_box_does_not_take_is_a_fault() -> None:
    bench = Bench(ForceLimits(bias_samples=5))
    sensor = settled(bench)
    bench.box.faults.deaf_to_bias = True
    with pytest.raises(DeviceFault, match=r"still reports 2 N"):
        sensor.bias()


@pytest.mark.parametrize("load_n", [0.15, 0.5, 3.0])
def test_17_a_bias_by_another_client_under_load_is_a_fault(bench: Bench, sensor: NetFt, load_n: float) -> None:
    sensor.bias()
    bench.wrench.extra_n = load_n
    for _ in range(100):
        assert next_of(sensor).health is Health.GOOD
    bench.box.request(encode_request(RdtCommand.BIAS), ("another", 1))
    assert fault_of(sensor, "became zero within one sample under load") <= 4


def test_17_a_bias_by_another_client_without_load_is_on_the_page(bench: Bench, sensor: NetFt) -> None:
    sensor.bias()
    sensor.check_configuration()
    next_of(sensor)
    bench.box.request(encode_request(RdtCommand.BIAS), ("another", 1))
    with pytest.raises(DeviceFault, match="another client has biased it"):
        sensor.check_configuration()
    with pytest.raises(DeviceFault, match="another client has biased it"):
        sensor.read(0.05)


@pytest.mark.parametrize("course", [
    lambda number: 2.0 - 0.05 * number if number < 40 else 0.0,  # unloaded within 0.2 s
    lambda number: 0.8 if number < 20 else max(0.8 - 0.4 * (number - 20), -0.8),  # friction
    lambda number: 3.0 if number < 20 else 0.6,  # a puncture
    lambda number: 2.0 if number < 20 else 1.0 if number < 21 else 0.0,  # let go, in two samples
], ids=["unloaded", "reversed", "punctured", "let go"])  # fmt: skip
def test_17_what_a_needle_does_is_no_bias(bench: Bench, course: Callable[[int], float]) -> None:
    bench.wrench.noise_n = 0.02
    sensor = settled(bench)
    sensor.bias()
    numbers = iter(range(1000))
    for _ in range(30):
        bench.wrench.extra_n = course(0)
        next_of(sensor)
    for _ in range(100):
        bench.wrench.extra_n = course(next(numbers))
        assert next_of(sensor).health is Health.GOOD


def test_17_a_restarted_stream_of_a_box_that_was_on_is_still_biased(bench: Bench, sensor: NetFt) -> None:
    sensor.bias()
    bench.wrench.extra_n = 2
    next_of(sensor)
    sensor.start()
    with pytest.raises(DeviceFault, match="under load"):
        sensor.bias()
    bench.box.reboot()
    sensor.start()
    sensor.bias()  # after a power cycle nobody knows what is load and what is offset
