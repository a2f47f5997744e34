"""The answer of `needleplan identify`: parameters with intervals, what the residuals say, and a figure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from needleplan.models import Estimate, Finding, Model

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Finding", "Identification"]


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
