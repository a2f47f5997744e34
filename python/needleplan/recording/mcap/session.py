"""What a recording says of the run as a whole: who made it, of which files, and what its clocks mean."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Self

from needleplan.artifacts import version
from needleplan.errors import DataError, Mistake

__all__ = ["FORMAT", "Session"]

FORMAT = "needleplan.recording/1"


@dataclass(frozen=True)
class Session:
    """The run as a whole.

    `digests` names the files it was made with (scenario, table, model, registration), `texts` holds whole files, such
    as the configuration, by their names; they become attachments. `monotonic_ns` and `wall_ns` are one moment on the
    two clocks: messages are stamped by the first, which nobody can set, and stored at the time of day that the pair
    makes of it. `force_axis` is the direction in the frame of the force sensor in which a resisting force is positive.
    """

    title: str = ""
    digests: Mapping[str, str] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)
    force_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    monotonic_ns: int = field(default_factory=time.monotonic_ns)
    wall_ns: int = field(default_factory=time.time_ns)
    made_by: str = field(default_factory=lambda: f"needleplan {version()}")

    def __post_init__(self) -> None:
        for name in ("digests", "texts"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def wall_of(self, monotonic_ns: int) -> int:
        """Return the time of day (ns since 1970) of a moment on the monotonic clock; not before 1970."""
        return max(monotonic_ns - self.monotonic_ns + self.wall_ns, 0)

    def monotonic_of(self, wall_ns: int) -> int:
        """Return the moment on the monotonic clock that was stored as `wall_ns`."""
        return wall_ns - self.wall_ns + self.monotonic_ns

    def to_dict(self) -> dict[str, Any]:
        """Return what is stored."""
        return {
            "format": FORMAT,
            "made_by": self.made_by,
            "title": self.title,
            "digests": dict(self.digests),
            "texts": dict(self.texts),
            "force_axis": list(self.force_axis),
            "monotonic_ns": str(self.monotonic_ns),  # as text: JSON readers round numbers of this size
            "wall_ns": str(self.wall_ns),
        }

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any], source: str = "") -> Self:
        """Return what `to_dict` stored. Raises DataError."""
        if stored.get("format") != FORMAT:
            raise DataError(Mistake("format", str(stored.get("format")), f"must be {FORMAT}"), source)
        try:
            x, y, z = (float(each) for each in stored["force_axis"])
            return cls(
                str(stored["title"]),
                {str(name): str(text) for name, text in stored["digests"].items()},
                {str(name): str(text) for name, text in stored["texts"].items()},
                (x, y, z),
                int(stored["monotonic_ns"]),
                int(stored["wall_ns"]),
                str(stored["made_by"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise DataError(Mistake("session", "", f"is damaged: {error!r}"), source) from error
