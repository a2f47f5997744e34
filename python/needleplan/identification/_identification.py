"""Input and result of an identification: records by their role, and the result that `needleplan identify` prints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.identification._entry_population import TipPrediction
from needleplan.models import Estimate, Finding, Model, ModelFile, Parent
from needleplan.recording import read_records
from needleplan.signals import Record, Role, fault_notes, records_of, require_one_frame

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from needleplan.models.deflection import FibreSensors

__all__ = ["Finding", "Identification", "Trials", "averaged", "trials_by_role", "undetermined"]


@dataclass(frozen=True)
class Identification(ShortRepr):
    """Result of the identification of a model from records.

    - `kind`: shaft-and-tip, force, friction, tissue-motion, deflection, curvature, duty-cycle or shape.
    - `model`: the identified model; None if nothing could be identified.
    - `estimates`: estimated parameters with their intervals, by name.
    - `scores`: further numbers as (name, value, unit), such as ("RMSE on held-out trials", 0.012, "N").
    - `findings`: results of tests, for example on the residuals.
    - `remarks`: sentences about the data, and about parameters that the data do not determine.
    - `draw`: function that draws data, model and residuals on a figure.
    - `prediction`: predicted tip of the next insertion; None for kinds without a path.
    - `fibre`: curvature sensors of the needle; None for kinds that do not use them.
    """

    kind: str
    model: Model | None
    estimates: dict[str, Estimate]
    scores: tuple[tuple[str, float, str], ...]
    findings: tuple[Finding, ...]
    remarks: tuple[str, ...]
    draw: Callable[[Figure], None]
    prediction: TipPrediction | None = None
    fibre: FibreSensors | None = None

    @property
    def ok(self) -> bool:
        """Whether there is a model to write."""
        return self.model is not None

    def model_file(self, records: Sequence[Record]) -> ModelFile | None:
        """Return the model file of the result, with the digests of the records; None without a model."""
        if self.model is None:
            return None
        parents = tuple(Parent(record.trial, record.digest) for record in records)
        names = self.model.parameters()
        estimates = {name: estimate for name, estimate in self.estimates.items() if name in names}
        about = f"{self.kind} identified from {len(records)} trials"
        return ModelFile(self.model, estimates, parents, self.remarks, about, fibre=self.fibre)


@dataclass(frozen=True)
class Trials:
    """Records by their role, with the remarks of their reading and a remark about noise records that are not used."""

    train: tuple[Record, ...]
    holdout: tuple[Record, ...]
    noise: tuple[Record, ...]
    remarks: tuple[str, ...]


def trials_by_role(given: object, *, noise_is_used: bool = False, faults_are_named: bool = False) -> Trials:
    """Sort records by their role; references are training records too.

    `given` are files, or records as for `needleplan.signals.records_of`.

    Raises DataError if no record has the role train, or if their frames differ.
    If there are records of noise and `noise_is_used` is False, a remark states that they are left out. If the
    identification names faults of the sensor in training trials itself (`faults_are_named`), the remarks of reading do
    not name them again.
    """
    records = records_of(given, read_records)
    train, holdout, noise = (
        tuple(record for record in records if record.role in roles)
        for roles in ((Role.TRAIN, Role.REFERENCE), (Role.HOLDOUT,), (Role.NOISE,))
    )
    if not train:
        rule = f"there is no trial to identify from: {len(holdout)} held out, {len(noise)} of noise"
        raise DataError(Mistake("role", "", rule))
    require_one_frame(records)
    named = {id(record): set(fault_notes(record)) for record in train} if faults_are_named else {}
    remarks = [
        f"{record.trial}: {note}".removeprefix(": ")
        for record in records
        for note in record.notes
        if note not in named.get(id(record), ())
    ]
    if noise and not noise_is_used:
        remarks.append(f"trials of noise are not used here, {len(noise)} left out")
    return Trials(train, holdout, noise, tuple(remarks))


def averaged(samples: int) -> str:
    """Return the remark that the force sensor is assumed to average this number of samples.

    The remark is needed because a wrong number biases the bristle parameters.
    """
    if samples == 1:
        return "assumed: the force sensor does not average"
    return f"assumed: the force sensor averages {samples} samples; if not, give its number with --average"


def undetermined(estimates: Mapping[str, Estimate]) -> list[str]:
    """Return a remark for each parameter that the data do not determine."""
    return [
        f"{name} is not identified: any value from {estimate.low:.3g} to {estimate.high:.3g} {estimate.unit}".rstrip()
        + " fits"
        for name, estimate in estimates.items()
        if not estimate.identified
    ]
