"""One class of tests on a device in this process, behind TCP and a pseudo-terminal, and on hardware if there is one."""

import os
from collections.abc import Iterator

import pytest

from needleplan.devices import Tracker
from needleplan.devices.endpoint import Endpoint, PtyEndpoint, TcpEndpoint
from needleplan.devices.ndi import NdiPoseLimits, NdiTracker
from needleplan.errors import AddressError, ConfigurationError, DeviceFault, LinkClosed
from tests.devices.contract import TrackerContract
from tests.devices.ndi.bench import TIP, Bench, aurora

HARDWARE = "NEEDLEPLAN_TEST_TRACKER"
PATIENT = NdiPoseLimits(late_s=5.0, silence_s=5.0, gap_s=1.0)
"""For a machine with other things to do than to run a simulated tracker."""
ENDPOINTS: dict[str, type[TcpEndpoint] | type[PtyEndpoint]] = {"tcp": TcpEndpoint, "pty": PtyEndpoint}


class TestInThisProcess(TrackerContract):
    @pytest.fixture(params=[False, True], ids=["bx", "tx"])
    def sensor(self, request: pytest.FixtureRequest) -> Tracker:
        return Bench(text=request.param).tracker()


class TestOnTheWire(TrackerContract):
    @pytest.fixture(params=["tcp bx", "tcp tx", "pty bx", "pty tx"])
    def sensor(self, request: pytest.FixtureRequest) -> Iterator[Tracker]:
        kind, reply = request.param.split()
        with ENDPOINTS[kind](aurora()) as end:
            address = f"{end.address}?tool={TIP}&reply={reply}"
            with NdiTracker.open(address, limits=PATIENT) as opened:
                yield opened


@pytest.mark.skipif(
    HARDWARE not in os.environ, reason=f"set {HARDWARE} to the address of a tracker with a coil in view"
)
class TestOnHardware(TrackerContract):
    @pytest.fixture
    def sensor(self) -> Iterator[Tracker]:
        with NdiTracker.open(os.environ[HARDWARE]) as opened:
            yield opened


def test_the_speed_of_a_serial_line_is_changed_at_both_ends() -> None:
    device = aurora()
    with PtyEndpoint(device) as end:
        with NdiTracker.open(f"{end.address}?tool={TIP}&speed=115200") as tracker:
            assert device.baud == 115_200
            assert tracker.read(1) is not None
        assert device.baud == 9600


def test_the_speed_is_changed_back_also_if_tracking_never_began() -> None:
    device = aurora()
    with PtyEndpoint(device) as end:
        with pytest.raises(ConfigurationError, match="must be the serial number of one tool"):
            NdiTracker.open(f"{end.address}?tool=none&speed=115200")
        assert device.baud == 9600


def test_25_a_device_that_does_not_follow_to_another_speed_is_a_fault() -> None:
    device = aurora()
    device.faults.ignore_speed = True
    with (
        PtyEndpoint(device) as end,
        pytest.raises(DeviceFault, match="answers at 9600 baud, but not at 115200"),
    ):
        NdiTracker.open(f"{end.address}?tool={TIP}&speed=115200")


@pytest.mark.parametrize("kind", ENDPOINTS)
def test_27_a_device_that_goes_away_closes_the_link(kind: str) -> None:
    end: Endpoint = ENDPOINTS[kind](aurora())
    with NdiTracker.open(f"{end.address}?tool={TIP}") as tracker:
        assert tracker.read(1) is not None
        end.close()
        with pytest.raises(LinkClosed):
            tracker.read(1)


def test_25_a_reset_over_the_wire_is_a_fault() -> None:
    device = aurora()
    with TcpEndpoint(device) as end, NdiTracker.open(f"{end.address}?tool={TIP}") as tracker:
        assert tracker.read(1) is not None
        end.say(device.reset())
        with pytest.raises(DeviceFault, match=r"reset itself|not possible in this mode"):
            list(iter(lambda: tracker.read(0.5), None))


@pytest.mark.parametrize(
    ("address", "message"),
    [("udp://127.0.0.1:1", "a tracker is reached by"), ("tcp://127.0.0.1?tol=1", "did you mean"),
     ("tcp://127.0.0.1?reply=gx", "reply = gx"), ("serial:///dev/null?timeout_s=1", "option = timeout_s")],
)  # fmt: skip
def test_wrong_addresses_are_refused(address: str, message: str) -> None:
    with pytest.raises(AddressError, match=message):
        NdiTracker.open(address)


def test_a_network_has_no_speed() -> None:
    with TcpEndpoint(aurora()) as end, pytest.raises(ConfigurationError, match="only a serial line"):
        NdiTracker.open(f"{end.address}?speed=115200")


def test_a_speed_that_the_device_does_not_know_is_refused() -> None:
    with PtyEndpoint(aurora()) as end, pytest.raises(ConfigurationError, match="must be one of 9600"):
        NdiTracker.open(f"{end.address}?speed=300")
