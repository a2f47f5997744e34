"""The whole arc of a step is tested: against finely sampled arcs and shapely, in tables and in executions."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from oracle_arc import COLLISION, EXIT, GOES_ON, TARGET, Problem, follow_arc, problem_from
from oracle_cases import case

import needleplan as npl
from needleplan.planning import Outcome
from needleplan.scenario import Grid, Layer, Needle, Obstacle, Scenario, Target, TipMotion, Tissue, Workspace

# Codes of the compiled lattice by the event of the oracle.
CODES = {GOES_ON: 0, TARGET: 1, COLLISION: 2, EXIT: 3}

# A spike and a wall that a step of 4 mm passes between two samples, and corners on the grid.
THIN = (
    Obstacle([(10, -1), (10.3, -1), (10.15, 9)]),
    Obstacle([(20, 8), (20.2, 8), (20.2, 18), (20, 18)]),
    Obstacle([(26, 4), (30, 4), (30, 6), (26, 6)]),
)


def scene(*obstacles: Obstacle, **changes: Any) -> Scenario:
    scenario = Scenario(
        Workspace(40, 20), Target((36, 10), 1), Needle(20), obstacles, TipMotion(30), Grid((2.0, 2.0), "interpolated")
    )
    return replace(scenario, **changes)


def fine_problem(scenario: Scenario, samples: int) -> Problem:
    motion = scenario.motion
    return problem_from(
        case(
            (scenario.workspace.width_mm, scenario.workspace.height_mm),
            target=(*scenario.target.center_mm, scenario.target.radius_mm),
            rho=scenario.needle.curvature_radius_mm,
            headings=motion.headings,
            obstacles=tuple([list(corner) for corner in each.polygon_mm] for each in scenario.obstacles),
            noise=motion.tip_noise,
            samples=samples,
            spacing=scenario.grid.spacing_mm,
            transition=scenario.grid.transition,
            layers=tuple((each.from_mm, each.curvature_radius_mm) for each in scenario.needle.layers),
            tissues=tuple((each.polygon_mm, each.curvature_radius_mm) for each in scenario.tissues),
        )
    )


@pytest.mark.slow
@pytest.mark.study
@pytest.mark.parametrize(
    "scenario",
    [
        scene(*THIN),
        scene(*THIN, grid=Grid((2.3, 1.7), "interpolated")),
        pytest.param(
            scene(*THIN, needle=Needle(20, [Layer(15, 12)]), tissues=(Tissue([(24, 0), (34, 0), (30, 12)], 30),)),
            marks=pytest.mark.slow,
        ),
        scene(*THIN, needle=Needle(200), motion=TipMotion(300)),
    ],
    ids=["thin", "odd spacing", "tissues", "nearly straight"],
)
def test_outcomes_are_those_of_finely_sampled_arcs(scenario: Scenario) -> None:
    problem = fine_problem(scenario, 60)
    outcomes = npl.plan(scenario).lattice.outcomes()
    nx, ny, headings, _ = outcomes.shape
    x, y = np.arange(nx) * problem.dx, np.arange(ny) * problem.dy
    starts = np.meshgrid(x, y, np.arange(headings) * problem.alpha, np.array((-1, 1)), indexing="ij")
    event, _, _ = follow_arc(problem, *starts)
    expected = np.vectorize(CODES.get)(event)
    free = outcomes < 4
    assert free.mean() > 0.8
    # A sampled arc may miss what it meets for less than the distance of two samples.
    assert np.mean(outcomes[free] != expected[free]) < 5e-3
    sampled_more = (expected != 0) & (outcomes == 0) & free
    assert not sampled_more.any()


def test_a_thin_wall_stops_every_step_that_crosses_it() -> None:
    wall = Obstacle([(20, -1), (20.001, -1), (20.001, 21), (20, 21)])
    table = npl.plan(scene(wall))
    assert table.success[:10].max() == 0
    found = table.rollout((0.0, 10.0, 0.0, 1), runs=500)
    assert found.success == 0
    sampled = npl.plan(scene(wall, motion=TipMotion(30, arc_samples=4)))
    assert sampled.success[:10].max() > 0.5


def test_an_execution_ends_where_the_arc_meets_the_obstacle() -> None:
    wall = Obstacle([(20, -1), (20.001, -1), (20.001, 21), (20, 21)])
    path = npl.plan(scene(wall)).path((18.7, 10.0, 0.0, 1))
    assert path.outcome is Outcome.COLLISION
    assert path.end.x_mm == pytest.approx(20, abs=1e-6)


@pytest.mark.slow
@pytest.mark.study
@pytest.mark.parametrize("name", [pytest.param("prostate", marks=pytest.mark.slow), "narrow_passage"])
def test_predictions_hold_for_arcs_that_are_tested_everywhere(name: str) -> None:
    """Executions with 1,000 tested points of an arc end as those with the whole arc."""
    table = npl.plan(name)
    start = np.array([table.best_entry().pose])
    options: dict[str, Any] = {"policy": table.policy, "values": table.values, "starts": start, "max_steps": 1000}
    whole = table.lattice.rollout(**options, runs=4000, seed=0)["outcome"]
    points = table.lattice.rollout(**options, runs=4000, seed=0, arc_samples=1000)["outcome"]
    assert np.mean(whole != points) < 2e-3


def test_the_key_is_left_out_or_a_number() -> None:
    assert scene().motion.arc_samples is None
    assert "arc_samples" not in scene().to_toml()
    text = scene(motion=TipMotion(30, arc_samples=4)).to_toml()
    assert "arc_samples = 4" in text
    assert Scenario.from_toml(text).motion.arc_samples == 4
