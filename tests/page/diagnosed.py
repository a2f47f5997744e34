"""One diagnosis of a few effects, for tests that only look at it."""

from dataclasses import replace
from functools import cache
from pathlib import Path

from needleplan.diagnosis import Diagnosis, Library, diagnose
from needleplan.models import Estimate, ModelFile
from needleplan.models.effects import effect_named
from needleplan.recording import write_records
from needleplan.reports.diagnosis import DiagnosisSource, next_trials_of, write_folder
from needleplan.signals import Record
from tests.diagnosis.trials import BASE, recordings

FEW = ("viscous", "stribeck", "bias")
# The model file says where the friction is, and is wrong about it; of the other parameters it has no interval.
GIVEN = replace(BASE, friction=BASE.friction / 2)
FILE = ModelFile(
    GIVEN, {"friction": Estimate(GIVEN.friction, 1e-9, GIVEN.friction - 2e-9, GIVEN.friction + 2e-9, "N/mm", True)}
)
HIDDEN = {"viscous": {"size": 1.5e-4}}
# A name that would break a page that takes it for markup.
ODD = "</script><b>first"


def trials() -> list[Record]:
    """Return recordings whose first trial has a name that would break a page."""
    first, *others = recordings(HIDDEN)
    return [Record(first.columns, ODD, first.role), *others]


@cache
def found(*, alone: bool = False) -> Diagnosis:
    """Return the diagnosis of all recordings, or of the first trial alone, in which nothing is named."""
    library = Library([effect_named(name) for name in FEW], BASE)
    return diagnose(FILE, trials()[:1] if alone else trials(), library=library)


def written(folder: Path, *, alone: bool = False) -> Path:
    """Write a diagnosis with its model and recordings, and return its folder."""
    FILE.write(folder / "base.toml")
    write_records(trials(), folder / "data.csv")
    library = Library([effect_named(name) for name in FEW], BASE)
    source = DiagnosisSource("base.toml", ("data.csv",))
    diagnosis = found(alone=alone)
    write_folder(diagnosis, FILE, library, str(folder / "found"), next_=next_trials_of(diagnosis), source=source)
    return folder / "found"
