"""`needleplan diagnose`: find where a model and recordings disagree, and which effect the model lacks.

Recorded insertions by a 3D table as the trials of a diagnosis.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.artifacts import CallRepr, FileKind, file_format
from needleplan.cli.answer import note, print_first, print_json, working
from needleplan.cli.data_options import add_data, data_files, naming, read_data, read_files, wrong_for_plans
from needleplan.cli.options import add_answer, add_output, require_free, require_rules
from needleplan.cli.parser import whole
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.anatomy import SpaceScenario
    from needleplan.identification.insertion_path import InsertionPath
    from needleplan.models import ModelFile
    from needleplan.scenario import Scenario
    from needleplan.signals import Record

__all__ = ["DiagnosedInsertions", "add_to", "read_insertions", "run"]


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
    mistakes = wrong_for_plans(options, "the model is an anatomy", ("--holdout", "--noise", "--reference", "--rate"))
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


# Beginnings of remarks on sensors along the needle and images, which are printed without --verbose, too.
_SENSORS = ("curvature along the needle:", "tip in images:")


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "diagnose",
        help="find where a model and recordings disagree, and name and add the missing effect",
        description="Compare a model with recordings: where they disagree, which effect is missing, how large it is, "
        "and whether it closes the gap; or report that the data do not show it. Trials have the roles train, holdout "
        "(another motion), reference (without the effect) and noise (the sensor at rest). Writes "
        "DIR/report.html, DIR/diagnosis.json and DIR/traces.h5, which `needleplan view DIR` shows, and DIR/model.toml "
        "if an effect was named. Exit code 0: no effect is missing, or it was named; 1: the missing effect could not "
        "be named.",
    )
    parser.add_argument(
        "model",
        metavar="MODEL.toml",
        help="the model, as needleplan identify writes it; or an anatomy, with recordings (.mcap) of insertions by its "
        "3D table: DIR/anatomy.toml has the diagnosed curvature",
    )
    add_data(parser)
    add_output(parser, "DIR", "write the results into this folder", required=True)
    parser.add_argument(
        "--without-references", action="store_true",
        help="leave out the recordings from which the model was identified; else they are references, if none is given",
    )  # fmt: skip
    parser.add_argument(
        "--strict", action="store_true",
        help="stop after the references if these show an effect or another law; three are needed",
    )  # fmt: skip
    parser.add_argument(
        "--merge-anyway", action="store_true", help="write model.toml also if the verdict is not `named`"
    )
    parser.add_argument(
        "--effects", action="append", default=[], metavar="FILE",
        help="also try the effect of a Python file, which is executed; may be given several times",
    )  # fmt: skip
    parser.add_argument(
        "--scenario",
        metavar="SCENARIO.toml",
        help="scenario to write with the identified curvature, or with the calibrated one if no effect was named; for "
        "models of a tip's path",
    )
    parser.add_argument(
        "--speed", type=float, metavar="MM_S", default=5.0, help="speed of the next insertion, mm/s (default: 5)"
    )
    parser.add_argument(
        "--trials", type=whole, metavar="N", default=1, help="number of further trials to propose together (default: 1)"
    )
    add_answer(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code: 0 if no effect is missing or it was named, else 1."""
    from needleplan.artifacts import require_different, require_folder
    from needleplan.config import Integer
    from needleplan.diagnosis import Verdict
    from needleplan.diagnosis.data import check_data
    from needleplan.models import ModelFile
    from needleplan.models.effects import register_file
    from needleplan.reports.diagnosis import (
        FILES,
        MOST_TRIALS,
        DiagnosisSource,
        diagnose_records,
        lines_of,
        motion_problem,
        next_trials_of,
        write_folder,
    )
    from needleplan.reports.diagnosis.corrected_plan import corrected_plan_lines, write_scenario
    from needleplan.reports.diagnosis.diagnosed_anatomy import corrected_anatomy_lines, write_anatomy

    require_rules(options, {"--trials": Integer(1, MOST_TRIALS)})
    for file in options.effects:
        register_file(file)
    kind = file_format(options.model).kind
    if kind is FileKind.TABLE:
        rule = "is a policy table; `needleplan compare TABLE.h5 RUN.mcap ...` judges what its plan claims"
        raise InputError(Mistake(options.model, "", rule))
    is_anatomy = kind is FileKind.ANATOMY
    scenario = None if is_anatomy else _scenario(options)
    require_folder(options.output)
    places = [Path(options.output) / name for name in FILES]
    require_free(options, places)
    require_different(
        [options.model, *data_files(options), *options.effects, *filter(None, [options.scenario])], places
    )
    old = [str(place) for place in places if place.is_file()]
    source = DiagnosisSource(
        options.model, tuple(options.data), tuple(options.holdout), tuple(options.noise), tuple(options.columns or ()),
        options.surface, options.rate, options.accept_units, tuple(options.effects), options.frame,
        tuple(options.reference), options.without_references, options.strict,
    )  # fmt: skip
    with working(options, "reading") as tell:
        if is_anatomy:
            insertions = read_insertions(options)
            file, records = insertions.file, insertions.records
        else:
            file = ModelFile.read(options.model)
            records = read_data(options, lambda read: check_data(read, file.model.channel))
            records += _identified(options, file, records)
        if problem := motion_problem(records, file.model):
            note(f"warning: the next motion will have no file: {problem}")
        with naming(options.model):
            found, model, library = diagnose_records(file, records, tell, strict=options.strict)
        tell("choosing the next motion")
        try:
            next_ = next_trials_of(found, options.trials)
        except InputError as error:  # the answer stands without a next motion
            next_ = None
            note(f"warning: no next motion: {error}")
        tell("writing the report")
        written = write_folder(
            found, model, library, options.output, next_=next_, merge_anyway=options.merge_anyway, source=source
        )
        lines = [*lines_of(found, next_)]
        if scenario:
            name, what = write_scenario(found, scenario, options.output, options.speed)
            written = (*written, name)
            plan_lines = corrected_plan_lines(found, what)
        if is_anatomy:
            name, anatomy = write_anatomy(
                found, insertions.scenario, insertions.training, options.output, options.speed
            )
            written = (*written, name)
            plan_lines = corrected_anatomy_lines(found, anatomy)
    if not options.json:
        print_first(options, lines)
        for remark in found.remarks if not options.verbose else ():
            if remark.startswith(_SENSORS):
                note(remark)
        if scenario or is_anatomy:
            print("\n".join(plan_lines))
    removed = _removed(written, old)
    if options.json:
        document = json.loads(Path(written[0]).read_text(encoding="utf-8"))
        print_json(document | {"written": list(written), "removed": removed})
    return 0 if found.verdict in (Verdict.NONE, Verdict.CHANGED, Verdict.NAMED) else 1


def _removed(written: Sequence[str], old: Sequence[str]) -> list[str]:
    """Print what became of the files of this and of an earlier diagnosis, and return the removed ones."""
    for file in written:
        note(f"wrote {file}")
    left = [file for file in old if file not in written]
    removed = [file for file in left if not Path(file).exists()]
    for file in left:
        note(f"{'removed' if file in removed else 'kept'} {file}: it belongs to an earlier diagnosis")
    return removed


def _identified(options: argparse.Namespace, file: ModelFile, records: list[Record]) -> list[Record]:
    """Return the recordings from which the model was identified, as references, and print what is said of them."""
    from needleplan.diagnosis.references import identified_from

    if options.without_references:
        return []
    found, remarks = identified_from(file, records, lambda files: read_files(options, files))
    for remark in remarks:
        note(remark)
    return found


def _scenario(options: argparse.Namespace) -> Scenario | None:
    """Return the scenario of `--scenario`, or None without the option. Called before the long computation.

    Raises InputError if the speed is not positive and finite, the model does not describe a path, or a file is wrong.
    """
    from needleplan.config import Number
    from needleplan.models import ModelFile
    from needleplan.reports.diagnosis.corrected_plan import require_path
    from needleplan.scenario import Scenario

    if not options.scenario:
        return None
    require_rules(options, {"--speed": Number("mm/s", above=0)})
    require_path(ModelFile.read(options.model).model.channel)
    return Scenario.read(options.scenario)
