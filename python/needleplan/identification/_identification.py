"""The answer of `needleplan identify`: parameters with intervals, what the residuals say, and a figure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from needleplan.errors import DataError, Mistake
from needleplan.models import Estimate, Finding, Model
from needleplan.signals import Record, Role

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Finding", "Identification", "Trials", "averaged", "trials_by_role"]


@dataclass(frozen=True)
class Identification:
    """What was identified from records.

    `model` is what a model file will hold, None where nothing could be identified; `scores` are further numbers with
    their unit, such as ("RMSE on held-out trials", 0.012, "N"); `remarks` are sentences about the data and about what
    they cannot tell; `draw` draws the figure.
    """

    kind: str
    model: Model | None
    estimates: dict[str, Estimate]
    scores: tuple[tuple[str, float, str], ...]
    findings: tuple[Finding, ...]
    remarks: tuple[str, ...]
    draw: Callable[[Figure], None]

    @property
    def ok(self) -> bool:
        """Whether there is a model to write."""
        return self.model is not None


@dataclass(frozen=True)
class Trials:
    """Records by their role, and as remarks what reading them had to say, and what is left out."""

    train: tuple[Record, ...]
    holdout: tuple[Record, ...]
    noise: tuple[Record, ...]
    remarks: tuple[str, ...]


def trials_by_role(records: Sequence[Record], *, noise_is_used: bool = False) -> Trials:
    """Sort records by their role. Raises DataError where there is none to identify from."""
    train, holdout, noise = (
        tuple(each for each in records if each.role is role) for role in (Role.TRAIN, Role.HOLDOUT, Role.NOISE)
    )
    if not train:
        rule = f"there is no trial to identify from: {len(holdout)} held out, {len(noise)} of noise"
        raise DataError(Mistake("role", "", rule))
    remarks = [f"{record.trial}: {note}".removeprefix(": ") for record in records for note in record.notes]
    if noise and not noise_is_used:
        remarks.append(f"trials of noise are not used here, {len(noise)} left out")
    return Trials(train, holdout, noise, tuple(remarks))


def averaged(samples: int) -> str:
    """Return what was taken for granted about the force sensor: a wrong average shifts the parameters of bristles."""
    if samples == 1:
        return "the force was taken as measured without an average"
    return f"the force was taken as an average of {samples} samples: say so where the sensor has another one, or none"
