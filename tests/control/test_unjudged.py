"""Real devices need a registration that has passed, or that a person accepts, also from Python."""

from dataclasses import replace

import pytest

from needleplan.control import Insertion
from needleplan.devices import Station, SystemClock
from needleplan.errors import DataError
from needleplan.estimation.registration import Registration, RegistrationVerdict, VerdictStatus
from tests.control.scenes import a_lab, small_table, station_of


def real() -> Station:
    """Return devices in real time."""
    return replace(station_of(a_lab()), clock=SystemClock())


@pytest.mark.parametrize("registration", [None, Registration(), Registration(coil_offset_mm=9.3)])
def test_without_a_verdict_no_real_device_is_used(registration: Registration | None) -> None:
    with pytest.raises(DataError, match=r"verdict.status = .none.: must be .passed. or .accepted. for real devices"):
        Insertion(small_table(), real(), registration=registration)
    Insertion(small_table(), station_of(a_lab()), registration=registration).close()  # simulated time


@pytest.mark.parametrize("status", [VerdictStatus.NONE, VerdictStatus.REFUSED, VerdictStatus.PASSED])
def test_a_person_accepts_a_registration_with_a_reason(status: VerdictStatus) -> None:
    reasons = ("residual: 3 mm",) if status is VerdictStatus.REFUSED else ()
    given = Registration(coil_offset_mm=9.3, verdict=RegistrationVerdict(status, 0.3, "at rest", reasons=reasons))
    accepted = given.accepted(" the coil of yesterday ")
    assert accepted.verdict == RegistrationVerdict(
        VerdictStatus.ACCEPTED, 0.3, "at rest", "the coil of yesterday", reasons
    )
    assert replace(accepted, verdict=given.verdict) == given
    assert Registration.from_toml(accepted.to_toml()) == accepted
    Insertion(small_table(), real(), registration=accepted).close()
    with pytest.raises(DataError, match=r"verdict.accepted = \"\": must be the reason"):
        given.accepted(" ")
