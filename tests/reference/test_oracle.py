"""The oracle against paper and pencil."""

import math
from typing import Any

import numpy as np
import pytest
from oracle_arc import (
    GOES_ON,
    follow_arc,
    follow_pieces,
    heading_spread,
    problem_from,
)
from oracle_cases import case, with_straight
from oracle_mdp import Mdp, Solution, build, solve
from oracle_rollout import rollout

STEP = math.pi / 2  # rho = 1, four headings: quarter circles that end exactly on the grid
CORNERS = ([[0, 1.9], [0.1, 1.9], [0.1, 2], [0, 2]], [[2, 0], [2, 0.1], [1.9, 0.1], [1.9, 0]])


def solved(scenario: dict[str, Any], residual: float = 1e-11) -> tuple[Mdp, Solution]:
    mdp = build(problem_from(scenario))
    return mdp, solve(mdp, residual)


def quarters(**changes: Any) -> dict[str, Any]:
    """Return the 2 mm square with obstacles in two corners and the target in a third."""
    usual: dict[str, Any] = {"target": (2.0, 2.0, 0.1), "rho": 1.0, "headings": 4, "obstacles": CORNERS}
    return case((2.0, 2.0), **(usual | changes))


def wiggly(transition: str, samples: int = 3, discount: float = 1.0) -> dict[str, Any]:
    return case(
        (9.0, 7.0),
        target=(7.3, 4.1, 0.9),
        rho=3.37,
        headings=9,
        obstacles=([[3, 0], [5.2, 0], [4.5, 2.2]], [[2, 5], [3, 7], [1, 7]]),
        noise=(0.5, 0.2, 0.05),
        samples=samples,
        transition=transition,
        objective=(1.0, 3.0, 60.0, 40.0, discount),
    )


@pytest.mark.slow
@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("discount", [1.0, 0.9])
def test_two_quarter_circles_by_hand(samples: int, discount: float) -> None:
    # (0,0,0 deg) --left--> (1,1,90 deg) --turn, right--> (2,2): one turn, two steps.
    _, solution = solved(quarters(samples=samples, objective=(1.0, 4.0, 1e4, 1e4, discount)))
    assert solution.values[1, 1, 1, 0] == pytest.approx(STEP, abs=1e-9)
    assert solution.values[1, 1, 1, 1] == pytest.approx(STEP + 4.0, abs=1e-9)
    assert solution.values[0, 0, 0, 1] == pytest.approx(STEP + discount * (STEP + 4.0), abs=1e-9)
    assert solution.values[0, 0, 0, 0] == pytest.approx(4.0 + STEP + discount * (STEP + 4.0), abs=1e-9)
    assert solution.values[0, 0, 3, 0] == pytest.approx(STEP + 1e4, abs=1e-9)  # both arcs leave: no turn
    assert solution.policy[0, 0, 0].tolist() == [1, 0]
    assert solution.policy[1, 1, 1].tolist() == [0, 1]
    assert solution.success[0, 0, 0].tolist() == [1.0, 1.0]
    assert solution.success[0, 0, 3].tolist() == [0.0, 0.0]
    assert solution.values[0, 2].max() == solution.values[2, 2].max() == 0.0  # absorbing


def test_the_radius_of_the_place_where_a_step_starts_by_hand() -> None:
    # (0,0,0 deg) --left, radius 1--> (1,1,90 deg) --turn, right, radius 2--> (3,3). The layer begins at x = 1, and is
    # overruled by the first tissue, which a later one overrules; the borders of both belong to them.
    regions = (([[1, 1], [2, 1], [2, 2]], 3.0), ([[0.5, 1], [1, 1], [1, 2], [0.5, 2]], 2.0))
    for layers, tissues in ((((1.0, 2.0),), ()), (((0.5, 7.0),), regions), (((1.0, 2.0), (2.0, 5.0)), ())):
        _, solution = solved(
            case((4.0, 4.0), target=(3.0, 3.0, 0.1), rho=1.0, headings=4, samples=3, layers=layers, tissues=tissues)
        )
        assert solution.values[1, 1, 1, 0] == pytest.approx(2 * STEP)
        if tissues:  # from the left edge, before the layer
            assert solution.values[0, 0, 0, 1] == pytest.approx(STEP + 4.0 + 2 * STEP)
        assert solution.policy[1, 1, 1].tolist() == [0, 1]


def test_an_execution_bends_as_the_tissue_under_it_by_hand() -> None:
    # Radius 2 up to x = 1, then 4. A quarter turn of radius 2, in 3 pieces of 30 degrees each: the first ends at
    # x = 1, so that the others turn by 15 degrees only.
    scenario = case((9.0, 9.0), target=(8.0, 8.0, 0.1), rho=2.0, headings=4, samples=3, layers=((1.0, 4.0),))
    here = [np.array([value]) for value in (0.0, 0.0, 0.0)]
    ending, x, y, theta = follow_pieces(problem_from(scenario), *here, np.array([1]))
    turned = np.radians([30, 45, 60])
    assert ending[0] == GOES_ON
    assert theta[0] == pytest.approx(turned[-1])
    assert x[0] == pytest.approx(2 * np.sin(turned[0]) + 4 * (np.sin(turned[-1]) - np.sin(turned[0])))
    assert y[0] == pytest.approx(2 * (1 - np.cos(turned[0])) - 4 * (np.cos(turned[-1]) - np.cos(turned[0])))


@pytest.mark.slow
def test_noise_moves_the_heading_after_the_arc_by_hand() -> None:
    # From (0,0,0 deg,+1) to (1,1) at 90 deg (1/2), 180 deg (1/4) or 0 deg (1/4). At 90: turn, hit the target. At 180:
    # turn and take the cheap collision. At 0: straight on to the target.
    mdp, solution = solved(quarters(noise=(0.5, 0.25), objective=(1.0, 2.0, 5.0, 100.0, 1.0)))
    assert solution.values[1, 1, 2].tolist() == pytest.approx([STEP + 5.0, STEP + 7.0])
    by_hand = STEP + 0.5 * (STEP + 2.0) + 0.25 * (STEP + 7.0) + 0.25 * STEP
    assert solution.values[0, 0, 0, 1] == pytest.approx(by_hand)
    assert solution.success[0, 0, 0, 1] == pytest.approx(0.75)
    assert solution.gap[0, 0, 0, 0] == pytest.approx(STEP + 100.0 - (2.0 + by_hand))
    # Here the true pose stays on the grid, so executions must realise what the table promises.
    for how in ({"policy": solution.policy}, {"greedy_values": solution.values}):
        runs = rollout(mdp, (0.0, 0.0, 0.0, 1), 20_000, seed=1, **how)
        assert runs.success == pytest.approx(0.75, abs=5 * math.sqrt(0.75 * 0.25 / 20_000))
        assert runs.cost.mean() == pytest.approx(by_hand, abs=5 * runs.cost.std() / math.sqrt(20_000))
        assert not np.any(runs.ending == GOES_ON)


def test_interpolated_corners_by_hand() -> None:
    # Spacing 2 mm: the arc from (0,0) ends at (1,1), a quarter of each corner: (2,0) obstacle, (2,2) target, and
    # (0,0), (0,2), where the next arc leaves. Turning is far too dear.
    scenario = quarters(
        obstacles=([[2, 0], [2, 0.1], [1.9, 0.1], [1.9, 0]],),
        spacing=(2.0, 2.0),
        transition="interpolated",
        objective=(1.0, 10.0, 1.0, 0.5, 0.9),
    )
    _, solution = solved(scenario)
    assert solution.values[0, 0, 0, 1] == pytest.approx(STEP + 0.9 * (0.5 * (STEP + 0.5) + 0.25 * 1.0))
    # The success is interpolated over the corners that are free: three quarters of the weight.
    assert solution.success[0, 0, 0, 1] == pytest.approx(0.25 / 0.75)
    assert solution.values[1, 0].tolist() == [[1.0, 1.0]] * 4  # the table's value of an obstacle point
    assert solution.values[1, 1].max() == 0.0
    assert solution.success[1, 1].min() == 1.0


def test_a_corner_beyond_the_border_is_a_state_of_its_own() -> None:
    # 2.5 mm wide, spacing 2: grid lines x = 0, 2, 4, which cover the workspace. From (2,0) the arc ends at
    # (2.25, 0.25): one eighth of it counts for x = 4.
    scenario = case(
        (2.5, 2.5),
        target=(0.5, 1.5, 0.1),
        rho=0.25,
        headings=4,
        spacing=(2.0, 2.0),
        transition="interpolated",
        objective=(1.0, 50.0, 9.0, 8.0, 0.9),
    )
    _, solution = solved(scenario)
    at_x = 0.875 * solution.values[:, 0, 1, 1] + 0.125 * solution.values[:, 1, 1, 1]
    assert len(at_x) == 3
    assert solution.q[1, 0, 0, 1, 0] == pytest.approx(0.25 * STEP + 0.9 * (0.875 * at_x[1] + 0.125 * at_x[2]))


@pytest.mark.slow
def test_steps_shorter_than_half_a_cell_never_end() -> None:
    # Steps of 0.31 mm: a grid point stays where it is, except where its arc meets the target or leaves the square.
    scenario = case((4.0, 4.0), target=(2.0, 2.0, 0.25), rho=0.5, headings=10)
    _, solution = solved(scenario)
    assert np.all(np.isinf(solution.values[1, 1]))
    assert np.isfinite(solution.values[0, 0]).any()
    _, discounted = solved(scenario | {"objective": scenario["objective"] | {"discount": 0.9}})
    assert discounted.values[1, 1] == pytest.approx(0.1 * math.pi / (1.0 - 0.9))


def test_a_line_to_the_target_by_hand() -> None:
    # From (0,2) along y = 2 in steps of 1.5 mm to the target, which begins at x = 5.5: the fourth step meets it.
    line = case((8.0, 4.0), target=(6.0, 2.0, 0.5), rho=2.0, headings=8, samples=3, spacing=(0.5, 0.5))
    for price, cost in ((None, 1.0), (0.5, 0.5)):
        _, solution = solved(with_straight(line, 0.0, price, step_mm=1.5))
        assert solution.values[0, 4, 0].tolist() == pytest.approx([4 * 1.5 * cost] * 2)
        assert solution.policy[0, 4, 0].tolist() == [2, 2]
        assert solution.success[0, 4, 0].tolist() == [1.0, 1.0]
    # With a price of clearance, a step that begins within 1 mm of the wall costs 0.25 more per mm.
    wall = line | {"obstacle": [{"polygon_mm": [[0, 0], [2, 0], [2, 1.1], [0, 1.1]]}]}
    priced = wall | {"objective": line["objective"] | {"clearance_mm": 1.0, "clearance_per_mm": 0.25}}
    _, solution = solved(with_straight(priced, 0.0, 0.5, step_mm=1.5))
    assert solution.values[0, 4, 0, 0] == pytest.approx(1.5 * (0.75 + 0.75 + 0.5 + 0.5))


def test_a_straight_step_of_half_the_curvature_by_hand() -> None:
    # Radius 1, four headings: a step is a quarter of a circle, pi/2 long. With half of the curvature it turns by 45
    # degrees on a circle of radius 2, and the two headings around that have half of the probability each.
    problem = build(problem_from(with_straight(quarters(), 0.5))).problem.straight
    assert problem is not None
    here = [np.array([value]) for value in (0.25, 0.25, 0.0)]
    for follow in (follow_arc, follow_pieces):
        ending, x, y, *turned = follow(problem, *here, np.array([1]))
        assert ending[0] == GOES_ON
        assert (x[0], y[0]) == pytest.approx((0.25 + 2 * math.sqrt(0.5), 0.25 + 2 * (1 - math.sqrt(0.5))))
        assert not turned or turned[0] == pytest.approx(math.pi / 4)
    assert heading_spread(problem) == pytest.approx({0: 0.5, 1: 0.5})


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.85, 1.0])
@pytest.mark.parametrize("noise", [(1.0,), (0.98, 0.01), (0.5, 0.2, 0.05)])
@pytest.mark.parametrize("motion", [{}, {"step_mm": 1.3}, {"step_mm": 1.3, "tip_noise_step_deg": 50.0}])
def test_the_spread_has_the_mean_of_the_turn_and_the_variance_of_the_noise(
    share: float, noise: tuple[float, ...], motion: dict[str, float]
) -> None:
    scenario = wiggly("nearest")
    scenario["motion"]["tip_noise"] = noise
    problem = problem_from(with_straight(scenario, share, **motion)).straight
    assert problem is not None
    whole = math.tau / 9
    turn = share * motion["step_mm"] / 3.37 / whole if motion else share
    eta = math.radians(motion["tip_noise_step_deg"]) / whole if "tip_noise_step_deg" in motion else 1.0
    spread = heading_spread(problem)
    headings, p = np.array(list(spread)), np.array(list(spread.values()))
    assert p.min() >= 0.0
    assert p.sum() == pytest.approx(1.0)
    assert p @ headings == pytest.approx(turn)
    wanted = 2 * sum(each * (m * eta) ** 2 for m, each in enumerate(noise))
    least = (turn - math.floor(turn)) * (math.ceil(turn) - turn)
    assert p @ (headings - turn) ** 2 == pytest.approx(max(wanted, least))
