"""Parameters that the thesis identified: section 2.5.2 (needle A) and Table 2.3 (needle B), all of Model II.

The shipped atlas `published` holds them. Here they carry the letters of the thesis: needle A is 18 GA, B is 22 GA;
tissue A is 4.5 % gellan gum, B is 6 %.
"""

from __future__ import annotations

from dataclasses import dataclass

from needleplan.identification.atlas import Atlas
from needleplan.models.force import ForceModel2

__all__ = ["PUBLISHED_FORCES", "PublishedForce"]


@dataclass(frozen=True)
class PublishedForce:
    """One column of Table 2.3, or one of the two sets of the text, with its mean absolute error on their data."""

    needle: str
    tissue: str
    velocity_mm_s: float
    depth_mm: float
    model: ForceModel2
    mae_n: float
    """Mean absolute error of the open-loop simulation against the measured force of Figs. 2.7 and 2.9 (N)."""

    source: str

    @property
    def title(self) -> str:
        """Short name, such as `A/A 10 mm/s`."""
        return f"{self.needle}/{self.tissue} {self.velocity_mm_s:g} mm/s"


def _published() -> tuple[PublishedForce, ...]:
    found = []
    for each in Atlas.read("published").combinations:
        assert isinstance(each.model, ForceModel2)
        assert each.mae_n is not None
        needle, tissue = "A" if each.needle.startswith("18 GA") else "B", "A" if "4.5 %" in each.tissue else "B"
        place = each.source.split("; ")[-1]
        found.append(PublishedForce(needle, tissue, each.velocity_mm_s, each.depth_mm, each.model, each.mae_n, place))
    return tuple(found)


PUBLISHED_FORCES = _published()
"""As printed. The positive f2 of B/B at 6 mm/s (g falls with depth) is legal. Order: text, then Table 2.3."""
