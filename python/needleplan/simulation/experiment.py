"""A simulated experiment: a setup, a program of moves and a seed, read from `needleplan.experiment/1`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from needleplan.artifacts import digest
from needleplan.errors import ExperimentError, Mistake
from needleplan.scenario import Scenario
from needleplan.scenario.shipped import text_of
from needleplan.simulation import toml
from needleplan.simulation.parts import Move
from needleplan.simulation.setup import Setup

__all__ = ["Experiment", "shipped_experiments"]

_FOLDER = Path(__file__).parent.parent / "experiments"


@dataclass(frozen=True)
class Experiment:
    """What is done in the lab twin; `scenario` is what was planned for, if anything, and `digest` names the file."""

    setup: Setup
    moves: tuple[Move, ...]
    seed: int = 0
    title: str = ""
    scenario: Scenario | None = None
    digest: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "moves", tuple(self.moves))
        mistakes = toml.unfit_moves(self.moves, self.setup.robot)
        if self.seed < 0:
            mistakes.append(Mistake("seed", f"{self.seed}", "must be a whole number from 0"))
        if mistakes:
            raise ExperimentError(mistakes)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Experiment:
        """Read an experiment file, or a shipped experiment by its name (`Experiment.read("insertion")`).

        Raises ExperimentError with every mistake of the file.
        """
        return cls.from_toml(text_of(path, _FOLDER, "experiment", ExperimentError), os.fspath(path))

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> Experiment:
        """Make an experiment of the text of a file; `source` names it in messages.

        Raises ExperimentError with every mistake of the text.
        """
        parts, mistakes = toml.parse(text)
        if mistakes:
            raise ExperimentError(mistakes, source)
        return cls(**parts, digest=digest(text))


def shipped_experiments() -> list[str]:
    """Return the names of the shipped experiments; `Experiment.read` takes a name where it takes a path."""
    return sorted(file.stem for file in _FOLDER.glob("*.toml"))
