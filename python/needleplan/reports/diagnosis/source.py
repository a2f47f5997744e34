"""How a diagnosis was made: model, recordings and options, as `diagnosis.json` keeps them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from needleplan.artifacts import CallRepr

__all__ = ["DiagnosisSource"]


@dataclass(frozen=True)
class DiagnosisSource(CallRepr):
    """Files and options of a diagnosis, as they were given to `needleplan diagnose`.

    Attributes
    ----------
    model
        The model file.
    data, holdout, reference, noise
        Files of recordings: with the roles that they state, of held-out trials, of trials without the effects, of the
        sensor at rest.
    columns, surface_mm
        Columns and units of foreign files, and the reading of the depth at the surface of the tissue.
    rate_hz
        Rate to which all trials were interpolated; None if they were used as recorded.
    accept_units
        Whether implausible sizes were accepted.
    effects
        Python files of further effects.
    frame
        Frame of the files that do not say it; None if none was given.
    without_references, strict
        Whether the recordings from which the model was identified were no references, and whether the diagnosis of the
        references could be the result.
    """

    model: str
    data: tuple[str, ...]
    holdout: tuple[str, ...] = ()
    noise: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    surface_mm: float | None = None
    rate_hz: float | None = None
    accept_units: bool = False
    effects: tuple[str, ...] = ()
    frame: str | None = None
    reference: tuple[str, ...] = ()
    without_references: bool = False
    strict: bool = False

    def document(self) -> dict[str, Any]:
        """Return the entry `source` of `diagnosis.json`, as a dictionary of JSON values."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}
