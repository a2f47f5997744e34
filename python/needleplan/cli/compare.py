"""`needleplan compare`: what a model or a plan predicts, beside recordings."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import Any

from needleplan.cli.answer import one_line, print_json, working
from needleplan.cli.data_options import add_data, naming, read_data, wrong_for_plans
from needleplan.cli.options import add_answer
from needleplan.errors import InputError

__all__ = ["add_to", "run"]


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "compare",
        help="compare the predictions of a model or of a plan with recordings",
        description="Compare predictions with recordings. A model predicts each trial: the RMS of the gap with all "
        "effects of the model and without them, the RMS of the noise, and the share of the gap that the effects "
        "explain. A plan predicts insertions: success, curvature, tip noise and plane, as planned and as measured, "
        "with 95 % intervals. Writes nothing. Exit code 0: the effects make the gap of every trial smaller, or the "
        "model has none, or all predictions of the plan hold; 1: not so.",
    )
    parser.add_argument("model", metavar="MODEL|TABLE.h5", help="a model file, such as that of a diagnosis, or a table")
    add_data(parser)
    parser.add_argument(
        "--fit", action="store_true",
        help="fit the parameters of the base model to each trial, with the effects and without; the effects stay",
    )  # fmt: skip
    add_answer(parser, verbose=False)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code: 0 if the effects make the gap of every trial smaller, else 1."""
    from needleplan.artifacts import FileKind, file_format, json_values
    from needleplan.models import ModelFile
    from needleplan.reports.diagnosis import compare

    known = file_format(options.model) if Path(options.model).is_file() else None
    if known is not None and known.kind is FileKind.TABLE:
        return _plan(options)
    with working(options, "comparing"):
        file = ModelFile.read(options.model)
        records = read_data(options)
        with naming(options.model):
            comparison = compare(file.model, records, fitted=options.fit)
    if options.json:
        trials = [asdict(trial) | {"explained": trial.explained} for trial in comparison.trials]
        record = {
            "model": file.model.name, "digest": file.digest, "effects": comparison.effects,
            "fitted": comparison.fitted, "unit": comparison.unit, "ok": comparison.ok, "trials": trials,
            "remarks": comparison.remarks,
        }  # fmt: skip
        print_json(json_values(record))
    else:
        for line in comparison.lines():
            print(one_line(line))
    return 0 if comparison.ok else 1


def _plan(options: argparse.Namespace) -> int:
    """Compare the claims of a table with recorded insertions. Return 0 if all of them hold, else 1."""
    from needleplan.artifacts import json_values
    from needleplan.control import recorded_coil_mm
    from needleplan.diagnosis.plan_claims import compare_plan
    from needleplan.planning import Table
    from needleplan.recording import Recording

    if mistakes := wrong_for_plans(options, "a plan is compared with recordings alone"):
        raise InputError(mistakes)
    with working(options, "comparing"):
        table, recordings = Table.read(options.model), [Recording.read(file) for file in options.data]
        coils = [coil_mm for recording in recordings if (coil_mm := recorded_coil_mm(recording)) is not None]
        found = compare_plan(table, recordings, median(coils) if coils else None)
    if options.json:
        claims = [asdict(claim) | {"holds": claim.holds} for claim in found.claims]
        record = {"table": options.model, "runs": found.runs, "ok": found.ok, "claims": claims}
        print_json(json_values(record | {"remarks": found.remarks}))
    else:
        for line in found.lines():
            print(one_line(line))
    return 0 if found.ok else 1
