"""Options of `needleplan identify` for known properties of needle, tissue and sensors."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from needleplan.cli.options import numbers
from needleplan.cli.parser import whole
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.models.deflection import FibreSensors

__all__ = ["add_knowledge", "knowledge", "sensors_at"]


@dataclass(frozen=True)
class _Option:
    """One option: its name, the keyword argument of `identify` that it sets, and the kinds that accept it.

    `help` is the help text; `reads` holds further arguments of `add_argument`.
    """

    flag: str
    keyword: str
    kinds: tuple[str, ...]
    help: str
    reads: dict[str, Any]


_OPTIONS = (
    _Option("--average", "average", ("shaft-and-tip", "force", "tissue-motion"),
            "number of samples that the force sensor averages; 1: no average (default: 5; shaft-and-tip 1)",
            {"type": whole, "metavar": "N"}),
    _Option("--model", "model", ("force",),
            "family of models: depth, those of the thesis, or relaxing, an elastic tissue with capsules, layers and "
            "Maxwell branches (default: depth)", {"choices": ("depth", "relaxing")}),
    _Option("--marker", "marker", ("tissue-motion",),
            "column that contains the displacement of a sensor in the tissue", {"choices": ("x_mm", "y_mm", "z_mm")}),
    _Option("--thickness", "thickness_mm", ("friction",),
            "thickness of the tissue (default: 76)", {"type": float, "metavar": "MM"}),
    _Option("--skip-cycles", "skip_cycles", ("friction",),
            "number of cycles left out at the beginning (default: 1)", {"type": whole, "metavar": "N"}),
    _Option("--mass", "mass", ("friction",),
            "identify the moving mass (inertia) together with the friction", {"action": "store_true", "default": None}),
    _Option("--offset", "offset", ("friction",),
            "identify an offset of the force sensor together with the friction",
            {"action": "store_true", "default": None}),
    _Option("--plane", "plane", ("curvature", "duty-cycle"), "plane of bending (default: xy)",
            {"choices": ("xy", "xz")}),
    _Option("--segments", "segments", ("curvature",),
            "number of equal parts of the path, each with its own curvature (default: 2)",
            {"type": whole, "metavar": "N"}),
    _Option("--skip", "skip_mm", ("curvature", "deflection", "duty-cycle"),
            "samples at smaller depths are left out (default: deflection 20, otherwise 0)",
            {"type": float, "metavar": "MM"}),
    _Option("--duty", "duty", ("duty-cycle",),
            "duty cycle of the straight steps of a plan, above 0 and at most 1 (default: 1)",
            {"type": float, "metavar": "SHARE"}),
    _Option("--predict-at", "at_mm", ("curvature", "deflection"),
            "length of the path at which the tip of the next insertion is predicted (default: the length that all "
            "trials reach)",
            {"type": float, "metavar": "MM"}),
    _Option("--other-series", "other_series", ("curvature", "deflection"),
            "files of the insertions of another series, on another day or after a new set-up, whose scatter and mean "
            "count for the predicted tip; once for each series",
            {"action": "append", "nargs": "+", "metavar": "FILE"}),
    _Option("--geometry", "needle", ("deflection",),
            "outer and inner diameter and length in mm, bevel angle in degrees (default: the 22-gauge needle of the "
            "thesis); if the stiffness changes, distances from the tip in mm with ratios to the tip",
            {"metavar": "OUTER,INNER,LENGTH,BEVEL[,MM:RATIO...]"}),
    _Option("--stiffness", "tissue", ("deflection",),
            "stiffness kf in N/mm2 (default: the soft gel of the thesis)", {"type": float, "metavar": "N_PER_MM2"}),
    _Option("--axial-offset", "axial_offset", ("deflection",),
            "axial force F0 without cutting and its standard deviation, in N, if measured",
            {"metavar": "N,SD"}),
    _Option("--sensors", "fibre", ("shape",),
            "distances of the curvature sensors from the tip in mm, the nearest first", {"metavar": "MM,MM"}),
    _Option("--boundary", "boundary_mm", ("shape",),
            "length of the needle up to a second layer (default: one layer)", {"type": float, "metavar": "MM"}),
    _Option("--tracked", "tracked_mm", ("deflection",),
            "distance of the tracked point behind the tip (default: 0)", {"type": float, "metavar": "MM"}),
)  # fmt: skip


def add_knowledge(parser: argparse.ArgumentParser) -> None:
    """Declare the options for known properties. The help of each option names the kinds that accept it."""
    group = parser.add_argument_group("known properties of needle, tissue and sensors")
    for each in _OPTIONS:
        group.add_argument(each.flag, help=f"{', '.join(each.kinds)}: {each.help}", dest=each.keyword, **each.reads)


def knowledge(options: argparse.Namespace) -> dict[str, Any]:
    """Return the keyword arguments of `identify` that the given options set.

    Raises InputError if the kind does not accept an option, or a value is not finite or otherwise wrong.
    """
    given = [each for each in _OPTIONS if getattr(options, each.keyword) is not None]
    wrong = [
        Mistake(each.flag, "", f"is for {_listed(each.kinds)}, not for {options.kind}")
        for each in given
        if options.kind not in each.kinds
    ]
    wrong += [
        Mistake(each.flag, str(value), "must be a finite number")
        for each in given
        if isinstance(value := getattr(options, each.keyword), float) and not math.isfinite(value)
    ]
    if wrong:
        raise InputError(wrong)
    return {each.keyword: _value(each, getattr(options, each.keyword)) for each in given}


def sensors_at(text: str) -> FibreSensors:
    """Return the sensors at the distances from the tip of `--sensors MM,MM`. Raises InputError or ModelError."""
    from needleplan.models.deflection import FibreSensors

    places = numbers("--sensors", text, text.count(",") + 1)
    if max(map(abs, places)) < 1.0:
        raise InputError(
            Mistake("--sensors", text, "is questionably small: give distances from the tip in mm, not in m")
        )
    return FibreSensors.at(places)


def _listed(kinds: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(kinds[:-1]), kinds[-1]]))


def _step(flag: str, text: str) -> tuple[float, float]:
    """Return distance and ratio of a change of the stiffness, MM:RATIO. Raises InputError."""
    place, _, ratio = text.partition(":")
    try:
        return float(place), float(ratio)
    except ValueError:
        raise InputError(Mistake(flag, text, "must be MM:RATIO, as in 40:8")) from None


def _value(option: _Option, given: Any) -> Any:
    from needleplan.models import NeedleShaft
    from needleplan.models.deflection import AxialOffset, ElasticTissue

    if option.keyword == "needle":
        first, steps = given.split(",")[:4], given.split(",")[4:]
        outer, inner, length, bevel = numbers(option.flag, ",".join(first), 4)
        pairs = tuple(_step(option.flag, step) for step in steps)
        return NeedleShaft(outer, inner, length, math.radians(bevel), stiffness_steps=pairs)
    if option.keyword == "fibre":
        return sensors_at(given)
    if option.keyword == "tissue":
        return ElasticTissue(given)
    if option.keyword == "axial_offset":
        return AxialOffset(*numbers(option.flag, given, 2))
    return given
