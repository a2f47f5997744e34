"""Options that bring identified models into a scenario, and what is said about them."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import note
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    from needleplan.identification.scenario_part import ScenarioPart
    from needleplan.scenario import Identified, Scenario

__all__ = ["Replaced", "add_identified", "part_lines", "part_record", "with_identified"]


@dataclass(frozen=True)
class Replaced:
    """A radius of the scenario that was replaced: of which place, by what, out of which file."""

    place: str
    found: Identified
    file: str

    def record(self) -> dict[str, Any]:
        """Return it for JSON."""
        low, high = self.found.interval_mm
        found = {"radius_mm": self.found.radius_mm, "interval_mm": [_number(low), _number(high)]}
        return {"place": self.place, **found, "kind": self.found.kind, "model": self.file, "digest": self.found.digest}


def add_identified(parser: argparse.ArgumentParser) -> None:
    """Declare the options that replace radii by identified ones."""
    parser.add_argument(
        "--needle",
        metavar="MODEL.toml",
        help="take the radius of the needle from this model, in place of that of the scenario and of its layers",
    )
    parser.add_argument(
        "--tissue",
        action="append",
        default=[],
        metavar="NAME=MODEL.toml",
        help="take the radius of the tissue of that name from this model; may be given more than once",
    )


def with_identified(scenario: Scenario, options: argparse.Namespace) -> tuple[Scenario, list[Replaced]]:
    """Return the scenario with the radii of the model files, and what was replaced. Raises InputError."""
    files = [("", options.needle)] if options.needle else []
    for each in options.tissue:
        name, equals, file = each.partition("=")
        if not (name and equals and file):
            raise ScenarioError(Mistake("--tissue", each, "must be NAME=MODEL.toml"))
        files.append((name, file))
    replaced = []
    for name, file in files:
        from needleplan.models import ModelFile
        from needleplan.scenario import identified, within

        found = identified(ModelFile.read(file), file)
        layers = len(scenario.needle.layers)
        try:
            scenario = scenario.with_curvature(
                within(found.pieces, scenario.workspace.width_mm) or found.curvature_per_mm, tissue=name
            )
        except ScenarioError as error:
            raise ScenarioError(error.mistakes, options.scenario) from None
        place = f"tissue {name}" if name else "needle"
        also = f"; it replaces {layers} layer{'s' * (layers != 1)} too" if layers and not name else ""
        note(f"{place}: {found}, {file}{also}")
        replaced.append(Replaced(place, found, file))
    return scenario, replaced


def part_lines(part: ScenarioPart | None) -> Iterator[str]:
    """Yield the tables of the scenario that were identified, below the remarks on them."""
    if part is None:
        return
    yield "scenario"
    for piece in part.pieces:
        low, high = sorted((1 / abs(piece.high_per_mm), 1 / abs(piece.low_per_mm)))
        radius = 1 / abs(piece.curvature_per_mm)
        yield f"  from x = {piece.low_mm:.4g} mm on: radius {radius:.4g} mm (95 % interval {low:.4g} to {high:.4g})"
    yield from (f"  {remark}" for remark in part.remarks)
    yield ""
    yield from part.lines()


def part_record(part: ScenarioPart | None, output: str | None) -> dict[str, Any]:
    """Return the same for JSON; nothing where no scenario was asked for."""
    if part is None:
        return {}
    noise = {"status": part.noise.status, "sd_rad": part.noise.sd_rad} if part.noise else None
    return {
        "scenario": {
            "pieces": [asdict(piece) for piece in part.pieces],
            "tip_noise": part.scenario.motion.tip_noise,
            "noise": noise,
            "remarks": part.remarks,
            "digest": part.scenario.digest,
            "output": output,
        }
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
