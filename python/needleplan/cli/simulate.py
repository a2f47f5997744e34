"""`needleplan simulate`: run a simulation in the lab twin."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import note, print_first, print_json, working
from needleplan.cli.options import add_answer, add_output, require_outputs, require_rules
from needleplan.cli.parser import whole
from needleplan.errors import Mistake

if TYPE_CHECKING:
    from needleplan.simulation import Run

__all__ = ["add_to", "run"]

_RECORDING = ".mcap"
_ENDINGS = (".csv", ".h5", ".hdf5", _RECORDING)


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "simulate",
        help="run a simulation in the lab twin",
        description="Run a simulation with a simulated robot, needle, tissue and sensors, faster than real time. "
        "Write the readings of the sensors as records for `needleplan identify`, or as a recording (MCAP).",
    )
    parser.add_argument(
        "simulation", metavar="SIMULATION.toml", help="a simulation file (.toml), or the name of a shipped simulation"
    )
    add_output(parser, "RUN", "write the records (.csv or .h5), or a recording (.mcap)")
    parser.add_argument("--seed", type=whole, metavar="N", help="seed that replaces the seed of the simulation")
    parser.add_argument(
        "--runs", type=whole, default=1, metavar="N", help="number of trials, with consecutive seeds (default: 1)"
    )
    add_answer(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command and return the exit code 0. Raises InputError."""
    from needleplan.recording import write_records
    from needleplan.simulation import Simulation, record_run, run_simulation

    _require(options)
    require_outputs(options, [options.simulation], options.output)
    simulation = Simulation.read(options.simulation)
    first = simulation.seed if options.seed is None else options.seed
    with working(options, "simulating") as tell:
        runs = []
        for seed in range(first, first + options.runs):
            tell(f"simulating, seed {seed}", (seed - first) / options.runs if options.runs > 1 else None)
            runs.append(run_simulation(simulation, seed))
        tell(f"writing {options.output}")
        if options.output and Path(options.output).suffix.lower() == _RECORDING:
            record_run(runs[0], options.output, overwrite=options.overwrite)
        elif options.output:
            write_records([each.record() for each in runs], options.output)
    if options.output:
        note(f"wrote {options.output}")
    for done in runs:
        if done.images and not _summary(done)["images_with_tip"]:
            note(f"warning: seed {done.seed}: no image has the tip; no move brings it into the slice of [ultrasound]")
    if options.json:
        print_json(
            {"title": simulation.title, "digest": simulation.digest, "output": options.output,
             "runs": [_summary(each) for each in runs]}
        )  # fmt: skip
    else:
        title = simulation.title or options.simulation
        print_first(options, [line for each in runs for line in _lines(each, title)])
    return 0


def _lines(done: Run, title: str) -> Iterator[str]:
    found = _summary(done)
    x, y, z = found["tip_mm"]
    yield f"{title}, seed {done.seed}"
    yield f"  simulated    {found['duration_s']:.4g} s, {found['samples']:,} samples, {len(done.phases)} moves"
    yield f"  tip          x {x:.2f} mm, y {y:.2f} mm, z {z:.2f} mm"
    yield f"  force        at most {found['largest_force_n']:.3g} N"
    yield f"  tracker      {found['missing_frames']} of {len(done.poses)} frames missing"
    if done.images:
        yield f"  ultrasound   the tip is in {found['images_with_tip']} of {len(done.images)} images"


def _require(options: argparse.Namespace) -> None:
    from needleplan.config import SEED, Integer

    mistakes = []
    if options.output and Path(options.output).suffix.lower() not in _ENDINGS:
        mistakes.append(Mistake("--output", options.output, f"must end in {', '.join(_ENDINGS)}"))
    if options.output and Path(options.output).suffix.lower() == _RECORDING and options.runs != 1:
        mistakes.append(Mistake("--runs", f"{options.runs}", "must be 1: a recording holds one run"))
    require_rules(options, {"--seed": SEED, "--runs": Integer(1, 10_000)}, *mistakes)


def _summary(done: Run) -> dict[str, Any]:
    from needleplan.devices import Health

    forces = [abs(force.force_n[2]) for force in done.forces]
    return {
        "seed": done.seed,
        "duration_s": done.stage[-1].stamp.device_time_s,
        "samples": len(done.stage) + len(done.forces) + len(done.poses),
        "tip_mm": list(done.tip.position_mm),
        "largest_force_n": max(forces, default=0.0),
        "missing_frames": sum(pose.health is Health.MISSING for pose in done.poses),
        "images_with_tip": sum(image.health is not Health.MISSING for image in done.images),
    }
