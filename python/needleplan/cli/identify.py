"""`needleplan identify`: identify models of the mechanics from recorded data."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import complain, note, print_first, print_json, working
from needleplan.cli.data_options import add_data, data_files, read_data, read_files
from needleplan.cli.force_library import add_store, require_library, store
from needleplan.cli.identify_options import add_knowledge, knowledge
from needleplan.cli.options import add_answer, add_figure, add_output, require_outputs
from needleplan.cli.parser import Parser, whole
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from collections.abc import Sequence

    from needleplan.identification import Identification
    from needleplan.identification.scenario_part import ScenarioPart
    from needleplan.models import ModelFile
    from needleplan.scenario import Scenario
    from needleplan.signals import Record

__all__ = ["KINDS", "add_to", "run"]

# Largest number of layers that a model file holds; a scenario holds more.
_MOST_LAYERS = 4

KINDS = ("shaft-and-tip", "force", "friction", "tissue-motion", "deflection", "curvature", "duty-cycle", "shape")


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: Parser = commands.add_parser(
        "identify",
        help="identify a model of the mechanics from recorded data",
        description="Identify a model from trials in CSV, HDF5 or MATLAB files: parameters with 95 % intervals, tests "
        "of the residuals, and remarks on the limits of the data. Exit code 1: nothing could be identified.",
    )
    parser.add_argument("kind", choices=KINDS, help="what to identify")
    add_data(parser)
    add_output(parser, "MODEL.toml", "write the model")
    parser.add_argument(
        "--scenario",
        metavar="SCENARIO.toml",
        help="scenario for which the identified tables [needle] and [motion] are printed (curvature, duty-cycle)",
    )
    parser.add_argument(
        "--layers",
        type=_layers,
        default="auto",
        metavar="N",
        help="curvature only: number of layers of equal depth (default: auto, insertions that are left out choose)",
    )
    parser.add_argument(
        "--scenario-out", metavar="FILE.toml", help="with --scenario: write the scenario with these tables"
    )
    add_store(parser)
    add_knowledge(parser)
    add_figure(parser, "data, model and what is left")
    add_answer(parser)
    parser.rename("--for", "--scenario")
    parser.rename("--at", "--predict-at")
    parser.rename("--atlas", "--force-library")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code: 0, or 1 if nothing could be identified."""
    from needleplan.artifacts import digest

    known = knowledge(options) | _layers_of(options)
    require_outputs(options, [*data_files(options), options.scenario], options.output, options.scenario_out)
    scenario, library = _scenario(options), require_library(options)
    with working(options, f"identifying {options.kind}") as tell:
        records = read_data(options)
        if options.other_series:
            known["other_series"] = [read_files(options, files) for files in options.other_series]
        found: Identification = _identifier(options.kind).identify(records, **known)
        file = found.model_file(records)
        if file and options.output:
            files = {digest(Path(name).read_bytes()): name for name in data_files(options)}
            file = file.with_files(files, Path(options.output).parent)
            file.write(options.output)
            note(f"wrote {options.output}")
        if options.figure:
            tell(f"drawing {options.figure}")
            _draw(found, options.figure)
        part = _part(found, scenario, records, options) if scenario and found.ok else None
        stored = store(library, found, records, options) if library and found.ok else {}
    if options.json:
        print_json(_record(found, records, file, options) | _part_record(part, options.scenario_out) | stored)
    else:
        shown = (
            options if found.ok else argparse.Namespace(verbose=True)
        )  # all lines, because the remarks say why nothing was identified
        print_first(shown, [*_lines(found)])
        for line in found.prediction.lines() if found.prediction else ():
            print(line)
        for line in _part_lines(part):
            print(line)
    return 0 if found.ok else complain("nothing could be identified from these data; the remarks say why")


def _draw(found: Identification, file: str) -> None:
    from matplotlib.figure import Figure

    from needleplan.plotting import save

    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    found.draw(figure)
    save(figure, file)
    note(f"drew {file}")


def _scenario(options: argparse.Namespace) -> Scenario | None:
    """Return the scenario of `--scenario`, or None without the option.

    Raises InputError if `--scenario` is given and the kind is not curvature, or if `--scenario-out` is given without
    `--scenario`.
    """
    from needleplan.scenario import Scenario

    if options.scenario is None:
        if options.scenario_out:
            raise InputError(Mistake("--scenario", "", "is missing: --scenario-out requires it"))
        return None
    if options.kind not in ("curvature", "duty-cycle"):
        rule = "must be curvature or duty-cycle: a scenario uses no other identified values"
        raise InputError(Mistake("--scenario", options.kind, rule))
    return Scenario.read(options.scenario)


def _layers(text: str) -> int | None:
    """Return the number of layers, or None for `auto`."""
    return None if text == "auto" else whole(text)


def _layers_of(options: argparse.Namespace) -> dict[str, Any]:
    """Return the keyword argument of `identify` for `--layers`, empty for `auto`.

    Raises InputError if a number of layers is given and the kind is not curvature.
    """
    if options.layers is None:
        return {}
    if options.kind != "curvature":
        raise InputError(Mistake("--layers", options.kind, "is for curvature only"))
    return {} if options.scenario and options.layers > _MOST_LAYERS else {"layers": options.layers}


def _part(
    found: Identification, scenario: Scenario, records: Sequence[Record], options: argparse.Namespace
) -> ScenarioPart:
    from needleplan.identification.scenario_part import ScenarioPart, scenario_part

    if options.kind == "duty-cycle":
        from needleplan.identification.duty_cycle import scenario_with_share

        changed, remarks = scenario_with_share(found, scenario)
        part = ScenarioPart(changed, (), None, remarks)
    else:
        part = scenario_part(
            records, scenario, layers=options.layers, plane=options.plane or "xy", skip_mm=options.skip_mm or 0.0
        )
    if options.scenario_out:
        part.scenario.write(options.scenario_out)
        note(f"wrote {options.scenario_out}")
    return part


def _identifier(kind: str) -> Any:
    """Return the module that identifies `kind` by its function `identify`. Raises InputError if it does not exist."""
    name = f"needleplan.identification.{kind.replace('-', '_')}"
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise InputError(Mistake("KIND", kind, "is not yet available")) from None


def _lines(found: Identification) -> Iterator[str]:
    kind = found.model.name if found.model else "no model"
    yield f"{found.kind}: {kind}"
    if found.estimates:
        width = max(map(len, found.estimates))
        scattered = any(estimate.between_sd is not None for estimate in found.estimates.values())
        column = f"{'sd of trials':>12}  " if scattered else ""
        yield f"  {'parameter':<{width}}  {'value':>10}  {'95 % interval':^24}  {column}unit"
        for name, each in found.estimates.items():
            interval = f"{_number(each.low):>10} to {_number(each.high):<10}" if each.identified else "not identified"
            between = "" if each.between_sd is None else _number(each.between_sd)
            unit = f"{between:>12}  {each.unit}" if scattered else each.unit
            yield f"  {name:<{width}}  {_number(each.value):>10}  {interval:^24}  {unit}".rstrip()
    if found.scores:
        width = max(len(name) for name, _, _ in found.scores)
        yield "scores"
        yield from (f"  {name:<{width}}  {_number(value):>10}  {unit}".rstrip() for name, value, unit in found.scores)
    if found.findings:
        width = max(len(finding.name) for finding in found.findings)
        yield "what is left"
        for test in found.findings:
            p_value = "" if test.p_value is None else f"p {test.p_value:.2g}"
            yield f"  {test.name:<{width}}  {p_value:<10}  {test.says}"
    if found.remarks:
        yield "remarks"
        yield from (f"  {remark}" for remark in found.remarks)


def _number(value: float) -> str:
    return f"{value:.4g}"


def _record(
    found: Identification, records: Sequence[Record], file: ModelFile | None, options: argparse.Namespace
) -> dict[str, Any]:
    return {
        "kind": found.kind,
        "model": found.model.name if found.model else None,
        "parameters": found.model.values() if found.model else {},
        "estimates": {name: asdict(each) for name, each in found.estimates.items()},
        "scores": [{"name": name, "value": value, "unit": unit} for name, value, unit in found.scores],
        "findings": [asdict(finding) for finding in found.findings],
        "remarks": found.remarks,
        "prediction": asdict(found.prediction) if found.prediction else None,
        "trials": [
            {"trial": record.trial, "role": record.role, "samples": len(record), "digest": record.digest}
            for record in records
        ],
        "digest": file.digest if file else None,
        "output": options.output if file else None,
        "figure": options.figure,
    }


def _part_lines(part: ScenarioPart | None) -> Iterator[str]:
    """Yield the printed lines on the scenario: radii of the pieces, remarks and identified tables.

    Yields nothing if `part` is None.
    """
    if part is None:
        return
    yield "scenario"
    for piece in part.pieces:
        ends = sorted((abs(piece.high_per_mm), abs(piece.low_per_mm)))
        radius = f"radius {1 / abs(piece.curvature_per_mm):.4g} mm" if piece.curvature_per_mm else "straight"
        straight = piece.low_per_mm <= 0 <= piece.high_per_mm
        reach = f"at least {1 / ends[1]:.4g}" if straight else f"{1 / ends[1]:.4g} to {1 / ends[0]:.4g}"
        yield f"  from x = {piece.low_mm:.4g} mm on: {radius} (95 % interval {reach})"
    yield from (f"  {remark}" for remark in part.remarks)
    yield ""
    yield from part.lines()


def _part_record(part: ScenarioPart | None, output: str | None) -> dict[str, Any]:
    """Return the JSON record of the identified values of the scenario, under the key `scenario`; {} for None."""
    if part is None:
        return {}
    noise = {"status": part.noise.status, "sd_rad": part.noise.sd_rad} if part.noise else None
    return {
        "scenario": {
            "pieces": [asdict(piece) for piece in part.pieces],
            "tip_noise": part.scenario.motion.tip_noise,
            "straight_curvature_share": part.scenario.motion.straight_curvature_share,
            "noise": noise,
            "remarks": part.remarks,
            "digest": part.scenario.digest,
            "output": output,
        }
    }
