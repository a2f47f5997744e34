"""Frames in which positions and depths are measured: name, origin, and who said so."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from needleplan.errors import DataError, Mistake

__all__ = ["FrameName", "RecordFrame"]


class FrameName(StrEnum):
    """The body whose axes the coordinates have.

    Examples
    --------
    >>> from needleplan.signals import FrameName
    >>> [str(name) for name in FrameName]
    ['guide', 'surface', 'tracker', 'plan', 'unknown']
    """

    GUIDE = "guide"
    """The guide or the robot: depth as the stage reads it."""

    SURFACE = "surface"
    """The surface of the tissue, with the origin where the needle enters it."""

    TRACKER = "tracker"
    """The tracker, before a registration."""

    PLAN = "plan"
    """The scenario or the anatomy that was planned for."""

    UNKNOWN = "unknown"
    """The file does not say it."""


@dataclass(frozen=True)
class RecordFrame:
    """The frame of the depths and positions of a record.

    Parameters
    ----------
    name : FrameName
        The body whose axes the coordinates have.
    origin : str
        What is at zero, such as "entry"; empty if unknown.
    provenance : str
        Who said so: a file, an option or a program.

    Examples
    --------
    >>> from needleplan.signals import FrameName, RecordFrame
    >>> print(RecordFrame(FrameName.SURFACE, "entry", "--surface 12"))
    surface, origin entry (--surface 12)
    >>> print(RecordFrame())
    unknown, origin unknown
    """

    name: FrameName = FrameName.UNKNOWN
    origin: str = ""
    provenance: str = ""

    @classmethod
    def parse(cls, text: str, provenance: str = "") -> RecordFrame:
        """Return the frame of a text such as `surface` or `surface: entry`.

        Parameters
        ----------
        text : str
            Name, and after a colon the origin.
        provenance : str
            Who said so.

        Returns
        -------
        RecordFrame
            The frame.

        Raises
        ------
        DataError
            If the name is unknown.
        """
        name, _, origin = (part.strip() for part in text.partition(":"))
        if name not in list(FrameName):
            rule = f"must be one of {', '.join(FrameName)}, if needed with its origin, as in surface: entry"
            raise DataError(Mistake("coordinate_frame", name, rule))
        return cls(FrameName(name), origin, provenance)

    @property
    def known(self) -> bool:
        """Whether the frame has a name."""
        return self.name is not FrameName.UNKNOWN

    @property
    def text(self) -> str:
        """Name and origin in the format of the files, such as "surface: entry"; the inverse of `parse`."""
        return f"{self.name}: {self.origin}" if self.origin else str(self.name)

    def __str__(self) -> str:
        provenance = f" ({self.provenance})" if self.provenance else ""
        return f"{self.name}, origin {self.origin or 'unknown'}{provenance}"
