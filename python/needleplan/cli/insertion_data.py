"""Recorded insertions by a 3D table as the trials of a diagnosis."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING

from needleplan.artifacts import CallRepr
from needleplan.cli.answer import note
from needleplan.cli.data_options import data_files, wrong_for_plans
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.anatomy import SpaceScenario
    from needleplan.identification.insertion_path import InsertionPath
    from needleplan.models import ModelFile
    from needleplan.signals import Record

__all__ = ["DiagnosedInsertions", "read_insertions"]

_RECORDING = ".mcap"


@dataclass(frozen=True, eq=False)
class DiagnosedInsertions(CallRepr):
    """Trials of a diagnosis, the plan and its model of the path, and the paths of the training trials."""

    scenario: SpaceScenario
    file: ModelFile
    records: list[Record]
    training: list[InsertionPath]


def read_insertions(options: argparse.Namespace) -> DiagnosedInsertions:
    """Read the recordings of `diagnose ANATOMY.toml RUN.mcap ...`. Raises InputError for other files and options."""
    from needleplan.anatomy import Anatomy, SpaceScenario
    from needleplan.control import recorded_insertion
    from needleplan.diagnosis.data import check_data
    from needleplan.identification.insertion_path import insertion_path
    from needleplan.recording import Recording, resampled
    from needleplan.reports.diagnosis.diagnosed_anatomy import planned_path_model
    from needleplan.signals import Role

    rule = "must be a recording (.mcap) of `insert`, of `simulate` for --noise: the model is an anatomy"
    files = data_files(options)
    mistakes = wrong_for_plans(options, "the model is an anatomy", ("holdout", "noise", "reference", "rate"))
    mistakes += [Mistake("DATA", file, rule) for file in files if not file.lower().endswith(_RECORDING)]
    mistakes += [Mistake("DATA", file, "is given twice") for file in {*files} if files.count(file) > 1]
    if mistakes:
        raise InputError(mistakes)
    scenario = SpaceScenario.of(Anatomy.read(options.model))
    by_role = ((options.data, Role.TRAIN), (options.holdout, Role.HOLDOUT), (options.reference, Role.REFERENCE))
    paths = [
        insertion_path(recorded_insertion(file, scenario), scenario, role) for files, role in by_role for file in files
    ]
    records = [path.record for path in paths]
    records += [Recording.read(file).tracker_noise() for file in options.noise]
    if options.rate is not None:
        records = [resampled(record, options.rate) for record in records]
    model = planned_path_model(scenario, paths)
    check_data(records, model.model.channel)
    note(f"{len(records)} recordings, {sum(map(len, records)):,} poses of the tracker")
    return DiagnosedInsertions(scenario, model, records, paths[: len(options.data)])
