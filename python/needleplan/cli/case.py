"""`needleplan case` makes an anatomy file of a folder with segmentations."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import note, print_json, print_summary, working
from needleplan.cli.options import (
    add_answer,
    add_output,
    options_named,
    require_ending,
    require_outputs,
    require_rules,
    split_numbers,
)
from needleplan.cli.parser import whole
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.anatomy import AnatomyCase, CaseChoices

__all__ = ["add_to"]

# Options by the argument of `read_case` that they give.
_KEYS = {
    "target": "--target-point",
    "entry": "--entry-point",
    "target_radius_mm": "--target-radius",
    "entry_radius_mm": "--entry-radius",
}
_ROLES = ("target", "entry", "obstacle", "tissue", "body", "ignored")


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "case",
        help="make an anatomy file of a folder with segmentations",
        description="Merge the segmentations of a folder (one mask a structure, several labels, layers; points of 3D "
        "Slicer) into one volume, propose the role of each structure by its name, and write an anatomy file that shows "
        "every decision. `needleplan entry` ranks its entries.",
    )
    parser.add_argument("folder", metavar="FOLDER", help="folder with .nii, .nii.gz, .nrrd, .mrk.json and .fcsv files")
    parser.add_argument(
        "--role", metavar="NAME=ROLE", action="append", default=[],
        help=f"role of a structure: {', '.join(_ROLES)} (default: by its name); may be repeated",
    )  # fmt: skip
    parser.add_argument("--target-point", metavar="POINT", help="marked point, or R,A,S in mm, that the tip must reach")
    parser.add_argument("--target-radius", type=float, metavar="MM", help="radius of the target around its point")
    parser.add_argument(
        "--entry-point", metavar="POINT",
        help="marked point, or R,A,S in mm, near which the needle enters (default: the skin nearest to the target)",
    )  # fmt: skip
    parser.add_argument(
        "--entry-radius", type=float, metavar="MM", default=25.0,
        help="radius of the entry region around its point (default: 25)",
    )  # fmt: skip
    parser.add_argument(
        "--radius", type=float, metavar="MM", required=True, help="radius of the needle's arc in tissue (required)"
    )
    parser.add_argument("--gauge", type=whole, metavar="N", help="thickness of the needle, 10 to 30")
    parser.add_argument(
        "--margin", type=float, metavar="MM", default=0.0, help="distance from obstacles, in mm (default: 0)"
    )
    add_output(parser, "CASE.toml", "write this anatomy file, with CASE.nii.gz and CASE.ctbl beside it", required=True)
    add_answer(parser)
    parser.set_defaults(run=_run_case)


def _run_case(options: argparse.Namespace) -> int:
    """Run `case` and return the exit code 0."""
    from needleplan.anatomy import case_files, read_case, write_case
    from needleplan.artifacts import is_device

    require_ending("--output", options.output, ".toml")
    if options.gauge is None and options.margin == 0:
        raise InputError(Mistake("--gauge", "", "is required without --margin: the needle has a thickness"))
    choices, file = _choices(options), Path(options.output)
    if is_device(file) or file.resolve().parent == Path(options.folder).resolve():
        rule = f"must be a file outside of {options.folder}, which is read: a volume lies beside it"
        raise InputError(Mistake("--output", options.output, rule))
    require_outputs(options, [], options.output, *map(str, case_files(file)))
    with working(options, "reading the segmentations"), options_named(_KEYS):
        case = read_case(options.folder, choices)
        write_case(case, file, curvature_radius_mm=options.radius, gauge=options.gauge, margin_mm=options.margin)
    if options.json:
        print_json(_record(case, options.output))
        return 0
    roles: dict[str, list[str]] = {}
    for structure in case.structures:
        roles.setdefault(str(structure.role), []).append(structure.name)
    shape = " x ".join(map(str, case.volume.labels.shape))
    lines = {role: ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
             for role, names in roles.items()}  # fmt: skip
    more = {
        structure.name: f"{structure.role}: {structure.reason}, {structure.volume_ml:.1f} ml, {structure.file}"
        for structure in case.structures
    }
    print_summary(options, options.folder, {**lines, "voxels": shape, "wrote": options.output}, more)
    for text in case.notes:
        note(text)
    note(f"roles are proposals: check {options.output}; next: needleplan entry {options.output}")
    return 0


def _choices(options: argparse.Namespace) -> CaseChoices:
    """Return the choices of the options. Raises InputError."""
    from needleplan.anatomy import CaseChoices, StructureRole
    from needleplan.config import Number

    mistakes: list[Mistake] = []
    roles: dict[str, StructureRole] = {}
    for text in options.role:
        name, _, role = text.rpartition("=")
        if not name or role not in _ROLES:
            mistakes.append(Mistake("--role", text, f"must be NAME=ROLE, with one of {', '.join(_ROLES)}"))
        elif roles.setdefault(name, StructureRole(role)) != role:
            mistakes.append(Mistake("--role", text, f"{name} has the role {roles[name]} already"))
    places: dict[str, str | tuple[float, float, float] | None] = {
        "target": _place(options.target_point), "entry": _place(options.entry_point)
    }  # fmt: skip
    for name, role in [*roles.items()]:
        if role in places:
            if places[role] is not None:
                mistakes.append(Mistake("--role", f"{name}={role}", f"is the second {role}"))
            places[role] = name
            del roles[name]
    require_rules(options, dict.fromkeys(("--target-radius", "--entry-radius"), Number("mm", above=0)), *mistakes)
    return CaseChoices(places["target"], places["entry"], options.target_radius, options.entry_radius, roles)


def _place(text: str | None) -> str | tuple[float, float, float] | None:
    """Return the position of R,A,S, else the name."""
    numbers = split_numbers(text) if text else []
    return (numbers[0], numbers[1], numbers[2]) if len(numbers) == 3 else text


def _record(case: AnatomyCase, output: str) -> dict[str, object]:
    """Return the JSON record of a case."""
    return {
        "anatomy": output,
        "structures": [asdict(structure) for structure in case.structures],
        "target": str(case.target),
        "entry": str(case.entry),
        "notes": list(case.notes),
    }
