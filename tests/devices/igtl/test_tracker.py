"""One class of tests on a server in this process, behind TCP, and on hardware behind PLUS if there is some."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from needleplan.devices import Health, Tracker
from needleplan.devices.igtl import IgtlPoseLimits, IgtlTracker, PlusServer, PoseKind
from needleplan.errors import AddressError, ConfigurationError, DeviceFault, LinkClosed, ProtocolError
from tests.devices.contract import TrackerContract
from tests.devices.igtl.bench import TIP, Bench, plus
from tests.devices.igtl.plus_link import PlusLink

HARDWARE = "NEEDLEPLAN_TEST_IGTL"
PATIENT = IgtlPoseLimits(start_s=20.0, silence_s=5.0, late_s=5.0)
"""For a machine with other things to do than to run a simulated tracker."""


class TestInThisProcess(TrackerContract):
    @pytest.fixture(params=PoseKind)
    def sensor(self, request: pytest.FixtureRequest) -> Tracker:
        return Bench(request.param).tracker()


class TestOnTheWire(TrackerContract):
    @pytest.fixture(params=PoseKind)
    def sensor(self, request: pytest.FixtureRequest) -> Iterator[Tracker]:
        kind: PoseKind = request.param
        with PlusServer(plus(kind, on_request=kind.holds_tools)) as server:
            ask = "&ask=yes" if kind.holds_tools else ""
            with IgtlTracker.open(f"{server.address}/{TIP}?message={kind}{ask}", limits=PATIENT) as opened:
                yield opened


@pytest.mark.skipif(
    HARDWARE not in os.environ, reason=f"set {HARDWARE} to the address of a tracker behind PLUS with a coil in view"
)
class TestOnHardware(TrackerContract):
    @pytest.fixture
    def sensor(self) -> Iterator[Tracker]:
        with IgtlTracker.open(os.environ[HARDWARE]) as opened:
            yield opened


def test_who_is_asked_to_send_is_asked_to_stop() -> None:
    device = plus(PoseKind.TDATA, on_request=True)
    with PlusServer(device) as server:
        with IgtlTracker.open(
            f"{server.address}/{TIP}?message=tdata&ask=yes&interval_ms=10", limits=PATIENT
        ) as tracker:
            assert tracker.read(5) is not None
            assert device.requested
        # The server takes up the next client when it is done with this one: the last query has been read then.
        with IgtlTracker.open(f"{server.address}/{TIP}?message=tdata&ask=yes", limits=PATIENT):
            queries = [each for each in device.queries if each != "GET_STATUS"]
            assert queries == ["STT_TDATA", "STP_TDATA", "STT_TDATA"]


def test_27_a_server_that_goes_away_closes_the_link_for_good() -> None:
    device = plus()
    server = PlusServer(device)
    with IgtlTracker.open(f"{server.address}/{TIP}", limits=PATIENT) as tracker:
        assert tracker.read(5) is not None
        server.close()
        with PlusServer(device, port=server.port) as again:
            for _ in range(2):
                with pytest.raises(LinkClosed):
                    list(iter(lambda: tracker.read(5), None))
            with IgtlTracker.open(f"{again.address}/{TIP}", limits=PATIENT) as opened_again:
                assert opened_again.read(5) is not None


@pytest.mark.parametrize(
    ("address", "message"),
    [("tcp://127.0.0.1:1/x", "must begin with igtl"), ("igtl://127.0.0.1", "must name the device"),
     ("igtl://127.0.0.1/", "must name the device"), ("igtl://127.0.0.1/a/b", "must name the device of the messages"),
     ("igtl://127.0.0.1/x?message=image", "message = image"), ("igtl://127.0.0.1/x?mesage=tdata", "did you mean"),
     ("igtl://127.0.0.1/x?rate_hz=-1", "rate_hz"), ("igtl://127.0.0.1/x?ask=perhaps", "ask = perhaps"),
     ("igtl:///x", "must name a host")],
)  # fmt: skip
def test_wrong_addresses_are_refused(address: str, message: str) -> None:
    with pytest.raises(AddressError, match=message):
        IgtlTracker.open(address)


def test_nobody_there_is_a_fault() -> None:
    server = PlusServer(plus())
    server.close()
    with pytest.raises(DeviceFault, match="cannot be reached"):
        IgtlTracker.open(f"{server.address}/{TIP}")


@pytest.mark.parametrize("kind", PoseKind)
def test_a_tool_that_is_not_sent_is_refused_with_those_that_are(kind: PoseKind) -> None:
    with pytest.raises(ConfigurationError, match=rf"name = Needle.*it sent: {kind.upper()} 'NeedleToTracker'"):
        Bench(kind).tracker("Needle")


def test_another_kind_of_message_than_the_one_that_is_sent_is_refused_with_that() -> None:
    with pytest.raises(ConfigurationError, match=r"must be a POSITION.*it sent: TRANSFORM 'NeedleToTracker'"):
        Bench().tracker(kind=PoseKind.POSITION)


def test_a_server_that_says_nothing_is_refused_in_time() -> None:
    bench = Bench()
    bench.faults.mute = True
    with pytest.raises(ConfigurationError, match="it sent: nothing"):
        bench.tracker()
    assert bench.clock.now_ns() < 3.1e9


def test_a_server_that_refuses_to_send_is_a_fault() -> None:
    bench = Bench(PoseKind.TDATA)
    bench.device.on_request = bench.device.refuse = True
    with pytest.raises(DeviceFault, match="refuses to send TDATA"):
        bench.tracker(ask=True)


def test_transforms_are_not_asked_for() -> None:
    with pytest.raises(ConfigurationError, match="only TDATA and QTDATA"):
        Bench().tracker(ask=True)


@pytest.mark.parametrize("kind", PoseKind)
def test_a_name_that_is_too_long_for_a_header_is_found(kind: PoseKind) -> None:
    bench = Bench(kind)
    bench.tip.name = "NeedleTipCoilToFieldGenerator"
    sample = bench.tracker("NeedleTipCoilToFieldGenerator").read(1)
    assert sample is not None
    assert sample.position_mm[2] == -150


@pytest.mark.parametrize("version", [1, 3])
def test_other_header_versions_will_do(version: int) -> None:
    bench = Bench()
    bench.device.version = bench.device.sent_version = version
    assert bench.tracker().read(1) is not None


def test_a_missing_checksum_is_accepted_by_an_explicit_option_only(monkeypatch: pytest.MonkeyPatch) -> None:
    receive = PlusLink.receive

    def without_crc(link: PlusLink, timeout_s: float) -> bytes:
        """Return the messages of the server with 0 in place of their checksums."""
        data, made = receive(link, timeout_s), b""
        while data:
            end = 58 + int.from_bytes(data[42:50])
            made += data[:50] + bytes(8) + data[58:end]
            data = data[end:]
        return made

    monkeypatch.setattr(PlusLink, "receive", without_crc)
    with pytest.raises((ConfigurationError, ProtocolError)):
        Bench().tracker()
    sample = Bench().tracker(needs_crc=False).read(1)
    assert sample is not None
    assert sample.position_mm[2] == -150
    with pytest.raises(AddressError, match="crc"):
        IgtlTracker.open("igtl://127.0.0.1/Tip?crc=no")


def test_a_frozen_pose_under_live_times_reaches_the_guard_as_new_samples() -> None:
    bench = Bench()
    bench.tip.pose = lambda _: ((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))
    tracker = bench.tracker()
    samples = [tracker.read(1) for _ in range(20)]
    assert len({sample.stamp.sequence for sample in samples if sample}) == 20
    assert {(sample.position_mm, sample.health) for sample in samples if sample} == {((1.0, 2.0, 3.0), Health.GOOD)}


def test_all_kinds_tell_the_same_pose() -> None:
    samples = [Bench(kind).tracker().read(1) for kind in PoseKind]
    first = samples[0]
    assert first is not None
    for each in samples:
        assert each is not None
        assert each.position_mm == pytest.approx(first.position_mm, abs=1e-5)
        assert each.quaternion == pytest.approx(first.quaternion, abs=1e-6)
        assert each.stamp.device_time_s == pytest.approx(first.stamp.device_time_s)
