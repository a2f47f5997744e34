"""The verdict as a registration file holds it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from needleplan.config import Choice, ConfigTable, Number, Text, Texts, raw_of, ruled, shown
from needleplan.errors import DataError, Mistake

__all__ = ["RegistrationVerdict", "VerdictStatus"]


class VerdictStatus(StrEnum):
    """Whether a registration may be used."""

    PASSED = "passed"
    """Nothing in the measurements speaks against the registration."""

    REFUSED = "refused"
    """The measurements contradict the registration."""

    ACCEPTED = "accepted"
    """A person accepts the registration and has given a reason."""

    NONE = "none"
    """The registration was not judged."""


def _accepted_with_reason(status: VerdictStatus, accepted: str) -> Iterator[Mistake]:
    """Yield a mistake unless exactly an accepted registration has the reason of a person."""
    if (status is VerdictStatus.ACCEPTED) is not bool(accepted.strip()):
        rule = f'must be the reason of the person if status = "{VerdictStatus.ACCEPTED}", else empty'
        yield Mistake("accepted", shown(accepted), rule)


@dataclass(frozen=True)
class RegistrationVerdict(ConfigTable, key="verdict", error=DataError, between=(_accepted_with_reason,)):
    """Verdict on a registration: status, noise of the tracker in the judgement, and the reasons against it.

    `accepted` is the reason of the person who accepted it. `noise_mm` is 0 if the noise is unknown.
    """

    status: VerdictStatus = ruled(Choice(VerdictStatus), VerdictStatus.NONE)
    noise_mm: float = ruled(Number("mm", at_least=0), 0.0)
    noise_source: str = ruled(Text(), "")
    accepted: str = ruled(Text(), "")
    reasons: tuple[str, ...] = ruled(Texts(), ())

    @property
    def ok(self) -> bool:
        """Whether the registration may be used: it passed, or a person accepted it."""
        return self.status in (VerdictStatus.PASSED, VerdictStatus.ACCEPTED)

    def raw(self) -> dict[str, object]:
        """Return the TOML table `[verdict]` as a dict, without the keys that have their default value."""
        default = raw_of(RegistrationVerdict())
        return {key: value for key, value in raw_of(self).items() if value != default[key]}
