"""Code that reproduces what the 3D page shows."""

from __future__ import annotations

import shlex
from dataclasses import dataclass

__all__ = ["SpaceCode"]


@dataclass(frozen=True)
class SpaceCode:
    """Where a 3D plan comes from, and how to compute it again.

    Attributes
    ----------
    source
        The policy table (.h5) or the anatomy (.toml); empty if the plan is from no file.
    is_table
        Whether it is a policy table.
    several
        Whether it is an anatomy with several targets.
    recording
        The recording of an insertion by this plan; empty without one.
    """

    source: str
    is_table: bool
    several: bool = False
    recording: str = ""

    def python(self, number: int) -> str:
        """Return Python that prints the numbers of an entry or replays the insertion; an empty text without a file."""
        if not self.source:
            return ""
        read = f"SpaceTable.read({self.source!r})" if self.is_table else (
            f"plan_space(SpaceScenario.of(Anatomy.read({self.source!r})))"
        )  # fmt: skip
        imports = [] if self.is_table else ["from needleplan.anatomy import Anatomy, SpaceScenario"]
        names = ["SpaceTable"] if self.is_table else ["plan_space"]
        if self.recording:
            lines = [
                *imports,
                "from needleplan.control import replay",
                f"from needleplan.planning import {names[0]}",
                "from needleplan.recording import Recording",
                "",
                f"table = {read}",
                f"report = replay(Recording.read({self.recording!r}), table).report",
                "print(report.outcome, round(report.error_in_space_mm, 2), report.turns)",
            ]
        elif self.several:
            lines = [
                "from needleplan.anatomy import Anatomy",
                "from needleplan.planning import rank_for_targets",
                "",
                f"entries = rank_for_targets(Anatomy.read({self.source!r}))",
                f"entry = entries.entry({number})",
                "print(entry.expected_number, entry.position_mm, list(entry.targets))",
            ]
        else:
            lines = [
                *imports,
                f"from needleplan.planning import {', '.join(sorted(['entry_map', *names]))}",
                "",
                f"entries = entry_map({read})",
                f"entry = entries.entry({number})",
                'print(f"success {entry.success}")',
                "print(entry.position_mm, entry.direction)",
            ]
        return "\n".join([*lines, ""])

    def command(self) -> str:
        """Return commands that rank the entries or replay the insertion; an empty text without a file."""
        if not self.source:
            return ""
        file = shlex.quote(self.source)
        if self.recording:
            lines = [] if self.is_table else [f"needleplan plan {file} -o table.h5"]
            table = file if self.is_table else "table.h5"
            lines.append(f"needleplan recording replay {shlex.quote(self.recording)} --table {table}")
        elif self.is_table:
            lines = [f"needleplan view {file}"]
        else:
            lines = [f"needleplan entry {file}"]
        return "\n".join([*lines, ""])
