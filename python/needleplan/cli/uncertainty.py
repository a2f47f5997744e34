"""Options of what is not known exactly, declared from `needleplan.planning.Uncertainty`, and the promise under it."""

from __future__ import annotations

import argparse
import math
from dataclasses import Field, fields
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import note
from needleplan.cli.options import numbers
from needleplan.cli.parser import Parser
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.planning import Promise, Table, Uncertainty
    from needleplan.scenario import Identified

__all__ = [
    "add_uncertainty",
    "promise_lines",
    "promise_record",
    "promised",
    "read_model",
    "read_registered",
    "read_uncertainty",
]

# What the parts of a promise are called in a summary.
_NAMES = {
    "exact": "as planned",
    "entry": "entry",
    "registration": "registration",
    "curvature": "curvature",
    "tip": "tip estimate",
    "together": "promise",
}


def add_uncertainty(parser: Parser, *, registration: bool = True) -> None:
    """Declare an option for each number of `Uncertainty`, and, if `registration`, `--registration`, a file."""
    group = parser.add_argument_group("uncertainty")
    parser.defer(lambda: _declare(group, registration))


def _declare(group: argparse._ArgumentGroup, registration: bool) -> None:
    for option, each in _options().items():
        ends = each.default if isinstance(each.default, tuple) else (each.default,)
        default = ",".join("left out" if end is None else f"{end:g}" for end in ends)
        is_pair = len(ends) > 1
        unit = each.name.rpartition("_")[2].upper()
        group.add_argument(
            option, type=str if is_pair else float, metavar="LOW,HIGH" if is_pair else unit,
            help=f"{each.metadata['about']} (default: {default})".replace("%", "%%"),
        )  # fmt: skip
    if registration:
        group.add_argument(
            "--registration",
            metavar="FILE",
            help="registration whose coil and errors the promise includes",
        )


def _options() -> dict[str, Field[Any]]:
    """Return the fields of `Uncertainty` that have an option, by its name."""
    from needleplan.planning import Uncertainty

    return {f"--{field.name.replace('_', '-')}": field for field in fields(Uncertainty) if field.metadata["about"]}


def read_registered(file: str | None) -> dict[str, Any]:
    """Return the error and the coil of a registration for `Uncertainty`; a remark says if it has no points."""
    if file is None:
        return {}
    from needleplan.estimation.registration import Registration

    registration = Registration.read(file)
    error = registration.error
    if error is None:
        note(f"warning: {file} has no points, so the promise does not include the error of the registration")
    return {"registration": error, "coil_mm": registration.coil_offset_mm}


def read_model(file: str | None) -> Identified | None:
    """Return what a model file says of the needle, or None without a file.

    Raises ModelError if the file is wrong or has no curvature.
    """
    if not file:
        return None
    from needleplan.models import ModelFile
    from needleplan.scenario import identified

    return identified(ModelFile.read(file), file)


def read_uncertainty(
    options: argparse.Namespace,
    registered: dict[str, Any] | None = None,
    model: Identified | None = None,
    planned_per_mm: float | None = None,
    curvature_ratio: tuple[float, float] | None = None,
) -> Uncertainty:
    """Return what is not known exactly: by the options, and for those that are left out by a model.

    `registered` is what `read_registered` returns, `model` an identified curvature and entry, `planned_per_mm` the
    curvature of the plan (1/mm), and `curvature_ratio` an interval of the curvature relative to it.
    """
    from needleplan.planning import Uncertainty

    given: dict[str, Any] = dict(registered or {})
    interval = model.ratios_to(planned_per_mm) if model and planned_per_mm else curvature_ratio
    if interval:
        given["curvature_ratio"] = interval
    if model and model.entry:
        entry = model.entry
        given |= {"entry_sd_mm": entry.offset_sd_mm, "heading_sd_deg": math.degrees(entry.heading_sd_rad)}
    for option, each in _options().items():
        if (value := getattr(options, each.name)) is not None:
            given[each.name] = tuple(numbers(option, value, 2)) if isinstance(value, str) else value
    try:
        return Uncertainty(**given)
    except InputError as error:
        names = {each.name: option for option, each in _options().items()}
        wrong = [
            Mistake(names.get(mistake.key, mistake.key), mistake.value, mistake.rule) for mistake in error.mistakes
        ]
        raise InputError(wrong) from None


def promised(table: Table, uncertainty: Uncertainty, pose: Any) -> Promise | None:
    """Return the promise from a pose, or None if everything is known exactly."""
    return None if uncertainty.is_exact else table.success_under(uncertainty, pose)


def promise_lines(promise: Promise | None) -> dict[str, str]:
    """Return the lines of a summary: the success as planned, under each error alone, and under all of them."""
    return {_NAMES[name]: str(part) for name, part in promise.parts().items()} if promise else {}


def promise_record(promise: Promise | None) -> dict[str, Any]:
    """Return the JSON record with the key `promise`, or an empty one if everything is known exactly."""
    return {"promise": promise.record()} if promise else {}
