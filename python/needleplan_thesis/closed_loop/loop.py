"""Once around: plan, insert, diagnose from recordings, plan again with what was named, insert again.

The lab twin hides something. The plan does not know it, and its insertions miss. Recordings of a few insertions into
the same tissue are diagnosed; where effects are left that explain them alike, the motion that the diagnosis asks for is
made, and all recordings are diagnosed again. The model with what was named is what the next plan is made from.
Insertions follow the moves of their plan without feedback, which would hide what the plan does not know.

Many rounds, in several processes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

from needleplan.diagnosis import Diagnosis, Library, Verdict, diagnose
from needleplan.diagnosis.next_motion import next_motion
from needleplan.models import Channel, Estimate, SpatialBicycle
from needleplan.models.effects import effects_of
from needleplan.planning import PolicyTable, plan
from needleplan.reports.diagnosis import CorrectedPlan, along_mm, corrected_plan, motion_text
from needleplan.scenario import Scenario
from needleplan.signals import Record
from needleplan.simulation import Experiment, Plant, SimulatedEntry
from needleplan_thesis.closed_loop.hidden import (
    NOTHING,
    SHAFT,
    HiddenEffect,
    another,
    hidden_named,
    laboratory,
    recordings,
)
from needleplan_thesis.processes import map_in_processes
from needleplan_thesis.steering import carried_out, path_end, planned_moves

__all__ = ["VELOCITY_MM_S", "NamedEffect", "OpenLoopInsertion", "Round", "diagnosed", "once_around", "run_rounds"]

VELOCITY_MM_S = 10.0
"""Of insertions by a plan."""

_VELOCITY_RAD_S = 10.0
_MORE = 2
"""How many times the motion that a diagnosis asks for is made."""

_RECORDED_FROM = 10_000
_A_ROUND = 100


@dataclass(frozen=True)
class OpenLoopInsertion:
    """An insertion by a plan: success promised and realised, and distance from the centre of the target in space."""

    promised: float
    success: bool
    error_mm: float


@dataclass(frozen=True)
class NamedEffect:
    """An effect that was named, with its parameters and their intervals."""

    name: str
    estimates: dict[str, Estimate]


@dataclass(frozen=True)
class Round:
    """What came of one time around, with one insertion for each of some seeds.

    `verdicts` are one more than the `motions` that were asked for and made.
    """

    hidden: str
    seeds: tuple[int, ...]
    verdicts: tuple[Verdict, ...]
    motions: tuple[str, ...]
    named: tuple[NamedEffect, ...]
    before: tuple[OpenLoopInsertion, ...]
    after: tuple[OpenLoopInsertion, ...]
    known: tuple[OpenLoopInsertion, ...]
    """By the first plan in a lab that hides nothing: what scatter alone leaves."""


def once_around(hidden: HiddenEffect, scenario: Scenario, seeds: Sequence[int]) -> Round:
    """Plan, insert, diagnose, plan again and insert again; the first of the seeds is that of the recordings too."""
    found, motions = diagnosed(hidden, scenario, seeds[0])
    last = found[-1]
    wrong = corrected_plan(_base(scenario), scenario, velocity_mm_s=VELOCITY_MM_S)
    right = corrected_plan(
        last.model, scenario, velocity_mm_s=VELOCITY_MM_S, stiffness_n_mm2=SHAFT.torsional_stiffness_n_mm2,
        shaft_mm=SHAFT.length_mm, places=along_mm(last.checked.training),
    )  # fmt: skip
    effects = last.effects if last.verdict is Verdict.NAMED else ()
    return Round(
        hidden.name,
        tuple(seeds),
        tuple(each.verdict for each in found),
        motions,
        tuple(NamedEffect(each.name, dict(each.estimates)) for each in effects),
        *(
            tuple(_inserted(lab, known, scenario, seed) for seed in seeds)
            for lab, known in ((hidden, wrong), (hidden, right), (NOTHING, wrong))
        ),
    )


def diagnosed(hidden: HiddenEffect, scenario: Scenario, seed: int) -> tuple[list[Diagnosis], tuple[str, ...]]:
    """Return the diagnoses, one after the other, and the names of the motions made between them."""
    setup = hidden.hide(laboratory(scenario))
    first = _RECORDED_FROM + _A_ROUND * seed
    data = recordings(setup, first)
    found = [_diagnose(scenario, data)]
    motions: list[str] = []
    while found[-1].verdict in (Verdict.AMBIGUOUS, Verdict.INCOMPLETE) and len(motions) < _MORE:
        wanted = next_motion(found[-1])
        if wanted is None:
            break
        moves = Experiment.from_toml(motion_text(wanted, found[-1].base)).moves
        data.append(another(setup, moves, first + len(data)))
        motions.append(wanted.program.name)
        found.append(_diagnose(scenario, data))
    return found, tuple(motions)


def _diagnose(scenario: Scenario, data: Sequence[Record]) -> Diagnosis:
    return diagnose(_base(scenario), data, library=_library(scenario))


def _base(scenario: Scenario) -> SpatialBicycle:
    return SpatialBicycle(curvature_per_mm=1 / scenario.needle.curvature_radius_mm)


@lru_cache(maxsize=1)
def _library(scenario: Scenario) -> Library:
    """Return the effects with what was computed for motions: recordings of all seeds have the same."""
    return Library(effects_of(Channel.TIP), _base(scenario))


def _inserted(hidden: HiddenEffect, known: CorrectedPlan, scenario: Scenario, seed: int) -> OpenLoopInsertion:
    table = _planned(known.scenario)
    start = table.best_entry().pose
    entry = SimulatedEntry(start.x_mm, start.y_mm, start.heading_rad - known.heading_rad)
    setup = hidden.hide(laboratory(scenario, entry))
    path = carried_out(
        Plant(setup, seed), planned_moves(table, start), VELOCITY_MM_S, _VELOCITY_RAD_S, known.torsion,
        known.bends.roll_rad,
    )  # fmt: skip
    end = path_end(scenario, path)
    success = not (end.touched or end.left) and end.distance_mm <= scenario.target.radius_mm
    return OpenLoopInsertion(float(table.lookup(*start).success), success, end.distance_mm)


@lru_cache(maxsize=4)
def _planned(scenario: Scenario) -> PolicyTable:
    return plan(scenario)


_SHARING = 5
"""Insertions that share a diagnosis, which takes longer than all of them."""


def run_rounds(
    scenario: Scenario, hidden: Sequence[HiddenEffect], seeds: Sequence[int], processes: int = 1
) -> Iterator[Round]:
    """Yield what comes of every hidden effect, in their order; five seeds share recordings and a diagnosis."""
    groups = [tuple(seeds[first : first + _SHARING]) for first in range(0, len(seeds), _SHARING)]
    tasks = [(each.name, group) for each in hidden for group in groups]
    yield from map_in_processes(partial(_round, scenario), tasks, processes)


def _round(scenario: Scenario, task: tuple[str, tuple[int, ...]]) -> Round:
    name, seeds = task
    return once_around(hidden_named(name), scenario, seeds)
