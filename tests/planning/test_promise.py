"""The success under what is not known exactly: closed forms, slow twins, and the exact success as its limit."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import needleplan as npl
from needleplan.anatomy import SpaceScenario
from needleplan.errors import InputError, PoseError
from needleplan.planning import PolicyTable, Promise, SpaceTable, Success, Uncertainty, plan, plan_space
from needleplan.planning._plane_truth import plane_truths
from needleplan.planning._promise import ErrorDraws, Truths
from needleplan.planning._space_truth import scattered_space_poses
from needleplan.scenario import Grid, Layer, Needle, Obstacle, Scenario, Target, TipMotion, Workspace
from needleplan.signals import RigidError
from tests.anatomy.volumes import TEXT, anatomy, box
from tests.planning.numpy_late import late_in_3d, late_in_plane
from tests.planning.numpy_promise import plane_twin, space_twin

pytestmark = pytest.mark.usefixtures("few_executions")

EXACT = Uncertainty()
ALL = Uncertainty(entry_sd_mm=0.8, heading_sd_deg=1.5, tre_mm=1.2, curvature_ratio=(0.8, 1.2), coil_mm=3.0)
# Without the tip noise that is known late, which is random in the twins too.
FIXED = replace(ALL, coil_mm=None)
# Standard deviations by which a share may differ from its probability.
SIGMAS = 4.0
# A start in the plane, away from the corners.
START = (0.0, 20.0, 0.3, -1)


@pytest.fixture(scope="module")
def plane() -> PolicyTable:
    """A narrow way past an obstacle."""
    obstacle = Obstacle(((22.0, 14.0), (30.0, 14.0), (30.0, 24.0), (22.0, 24.0)), "vessel")
    return plan(
        Scenario(
            Workspace(60.0, 40.0), Target((50.0, 26.0), 1.5), Needle(40.0, (Layer(25.0, 60.0),)),
            obstacles=(obstacle,), motion=TipMotion(headings=36, step_mm=4.0), grid=Grid((1.0, 1.0)),
        )
    )  # fmt: skip


def space_table(tip_noise_deg: float) -> SpaceTable:
    text = TEXT.replace("radius_mm = 60.0", f"radius_mm = 60.0\ntip_noise_deg = {tip_noise_deg}")
    curved = text.replace("[needle]", '[[anatomy.curvature]]\nlabel = "entry"\nradius_mm = 45.0\n[needle]')
    return plan_space(SpaceScenario.of(anatomy(box(), curved)), threads=1)


@pytest.fixture(scope="module")
def space() -> SpaceTable:
    return space_table(6.0)


@pytest.fixture(params=["plane", "space"])
def table(request: pytest.FixtureRequest) -> Any:
    return request.getfixturevalue(request.param)


def outcomes(table: Any, uncertainty: Uncertainty, pose: Any, runs: int, seed: int) -> NDArray[np.bool_]:
    """Return which executions reach the target."""
    draws = ErrorDraws.of(runs, seed)
    motions = table._error_in_plan(uncertainty.rigid_error()).motions(draws.registration)
    starts = table._scattered(pose, uncertainty, draws.entry)
    return np.asarray(
        table._reached(starts, Truths(motions, uncertainty.ratios(draws.curvature), uncertainty.coil_mm or 0.0), seed)
    )


def is_likely(share: Success, probability: float) -> bool:
    """Return whether a share of executions differs from a probability by chance."""
    sd = math.sqrt(probability * (1 - probability) / share.runs)
    return abs(share.value - probability) < SIGMAS * sd


def test_without_errors_it_is_the_success_of_today(table: Any) -> None:
    best = table.best_entry()
    runs, numbers = 500, table.rollout(best, 500, seed=7)
    reached = outcomes(table, EXACT, best, runs, 7)
    assert reached.mean() == numbers.success
    samples = [path.outcome == "target" for path in table.rollout(best, 40, seed=7).samples]
    if isinstance(table, SpaceTable):  # the samples of the plane have seeds of their own
        assert reached[:40].tolist() == samples
    promise = table.success_under(EXACT, best, executions=runs, seed=7)
    assert promise.parts() == {"exact": promise.exact, "together": promise.exact}
    assert promise.exact == (
        table.estimate(best, runs, 7) if isinstance(table, SpaceTable) else Success(*_share(numbers))
    )


def _share(numbers: Any) -> tuple[float, tuple[float, float], Any, int]:
    low, high = numbers.interval
    return numbers.success, (min(low, numbers.success), max(high, numbers.success)), "executions", numbers.runs


def test_the_success_is_continuous_at_no_error(table: Any) -> None:
    tiny = Uncertainty(1e-9, 1e-9, 1e-9, (1 - 1e-9, 1 + 1e-9))
    best = table.best_entry()
    differs = outcomes(table, tiny, best, 300, 1) != outcomes(table, EXACT, best, 300, 1)
    assert differs.mean() < 0.01


def test_it_is_the_same_for_any_number_of_threads(plane: PolicyTable, space: SpaceTable) -> None:
    draws = ErrorDraws.of(200, 3)
    motions, ratios = ALL.rigid_error().motions(draws.registration), ALL.ratios(draws.curvature)
    starts = plane._scattered(START, ALL, draws.entry)
    truths = plane_truths(Truths(motions, ratios, ALL.coil_mm), plane.scenario.target_mm)
    of_plane = [
        plane.lattice.rollout(plane.policy, plane.values, starts, runs=1, seed=3, greedy=True, max_steps=1000,
                              truths=truths, threads=threads)["length_mm"]
        for threads in (1, 3)
    ]  # fmt: skip
    assert np.array_equal(*of_plane)
    poses = space._scattered(space.best_entry(), ALL, draws.entry)
    poses, rows = (
        poses[~np.isnan(poses[:, 0])],
        np.column_stack([motions.reshape(-1, 12), ratios, np.full(200, ALL.coil_mm)]),
    )
    of_space = [
        space.solved.true_outcomes(poses, rows[: len(poses)], center_mm=space.scenario.target_mm, seed=3, threads=each)
        for each in (1, 3)
    ]
    assert np.array_equal(*of_space)


def test_each_error_alone_and_all_together(table: Any) -> None:
    best = table.best_entry()
    promise = table.success_under(ALL, best, executions=200, seed=2)
    assert list(promise.parts()) == ["exact", "entry", "registration", "curvature", "tip", "together"]
    assert promise.registration.value < promise.exact.value
    for name, part in ALL.parts().items():
        alone = table.success_under(part, best, executions=200, seed=2)
        assert getattr(promise, name) == getattr(alone, name) == alone.together
        assert alone.exact == promise.exact
    assert promise == table.success_under(ALL, best, executions=200, seed=2)
    record = promise.record()
    assert record["together"] == promise.together.record()
    assert record["uncertainty"]["curvature_ratio"] == (0.8, 1.2)


def test_wrong_input_is_one_error(table: Any) -> None:
    best = table.best_entry()
    for wrong in ({"executions": 0}, {"executions": 1.5}, {"seed": -1}):
        with pytest.raises(PoseError, match=next(iter(wrong))):
            table.success_under(ALL, best, **wrong)
    with pytest.raises(PoseError):
        table.success_under(ALL, "here")
    with pytest.raises(InputError, match="uncertainty"):
        table.success_under(1.5, best)
    with pytest.raises(InputError) as found:
        Uncertainty(entry_sd_mm=-1, curvature_ratio=(1.2, 0.8), registration="file")  # type: ignore[arg-type]
    assert {each.key for each in found.value.mistakes} == {"entry_sd_mm", "curvature_ratio", "registration"}
    with pytest.raises(InputError, match="left out"):
        Uncertainty(tre_mm=1.0, registration=RigidError.of_tre(1.0))


# Closed forms: a nearly straight needle without tip noise that is aimed at the centre of a target without obstacles.


@pytest.fixture(scope="module")
def free_plane() -> tuple[PolicyTable, tuple[float, ...]]:
    scenario = Scenario(
        Workspace(60.0, 40.0), Target((50.0, 20.0), 2.0), Needle(2000.0),
        motion=TipMotion(headings=360, step_mm=4.0, tip_noise=(1.0,)), grid=Grid((2.0, 2.0)),
    )  # fmt: skip
    return plan(scenario), (0.0, 20.0, 0.0, 1)


@pytest.fixture(scope="module")
def free_space() -> tuple[SpaceTable, tuple[float, ...]]:
    labels = box()
    labels[labels == 4] = 1
    text = TEXT.replace("radius_mm = 60.0", "radius_mm = 2000.0\ntip_noise_deg = 1e-6").replace(
        'obstacles = ["vessel"]', "obstacles = []"
    )
    text = text.replace('target = "target"', "target = { center_mm = [19.0, 19.0, 48.0], radius_mm = 4.0 }")
    table = plan_space(SpaceScenario.of(anatomy(labels, text)), threads=1)
    x, y, z = table.scenario.target_mm
    return table, (x - 32.0, y, z, 1.0, 0.0, 0.0)


@pytest.mark.parametrize("kind", ["plane", "space"])
def test_a_shift_reaches_a_ball_by_the_distribution_of_its_length(kind: str, request: pytest.FixtureRequest) -> None:
    table, start = request.getfixturevalue(f"free_{kind}")
    radius = 2.0 if kind == "plane" else 4.0
    for tre in (0.8 * radius, 1.5 * radius):
        found = table.success_under(Uncertainty(tre_mm=tre), start, executions=2000, seed=4)
        assert found.exact.value == 1
        # The length of an isotropic normal shift, in units of its standard deviation, has a chi distribution.
        assert is_likely(found.together, stats.chi2.cdf(3 * (radius / tre) ** 2, 3))


@pytest.mark.parametrize("kind", ["plane", "space"])
def test_a_lateral_shift_and_a_turn_reach_it_by_a_normal_distribution(
    kind: str, request: pytest.FixtureRequest
) -> None:
    table, start = request.getfixturevalue(f"free_{kind}")
    radius = 2.0 if kind == "plane" else 4.0
    axes = table.scenario.grid.frame.axes if kind == "space" else np.eye(3)
    target = table.scenario.grid.frame.world(table.scenario.target_mm) if kind == "space" else np.array([50.0, 20.0, 0])
    both = np.kron(np.eye(2), axes.T)

    def error(sds: list[float], ahead_mm: float) -> Uncertainty:
        """Return an error along axes of the plan, about a point before the target."""
        covariance = both @ np.diag(np.square(sds)) @ both.T
        return Uncertainty(registration=RigidError(target - ahead_mm * axes[0], (covariance + covariance.T) / 2))

    lateral = table.success_under(error([0, 0, 0, 0, radius, 0], 0.0), start, executions=2000, seed=5)
    assert is_likely(lateral.together, 1 - 2 * stats.norm.sf(1.0))
    disc = table.success_under(error([0, 0, 0, 0, radius, radius], 0.0), start, executions=2000, seed=5)
    assert is_likely(disc.together, stats.chi2.cdf(1.0, 2))
    turn = table.success_under(error([0, 0, 0.01, 0, 0, 0], 100 * radius), start, executions=2000, seed=6)
    assert is_likely(turn.together, 1 - 2 * stats.norm.sf(1.0))


# Slow twins.


def test_executions_in_the_plane_are_those_of_the_twin(plane: PolicyTable) -> None:
    table = replace(plane, scenario=replace(plane.scenario, motion=replace(plane.scenario.motion, tip_noise=(1.0,))))
    draws = ErrorDraws.of(40, 5)
    starts = table._scattered(START, ALL, draws.entry)
    motions, ratios = ALL.rigid_error().motions(draws.registration), ALL.ratios(draws.curvature)
    truths = plane_truths(Truths(motions, ratios), table.scenario.target_mm)
    found = table._execution(nearest=False).reached(starts, truths, 0)
    assert 5 < found.sum() < 35
    # Near a border of a layer the pieces of an arc have another curvature than its points.
    assert (found == plane_twin(table, starts, truths[:, :5])).sum() >= 38


def test_executions_in_3d_are_those_of_the_twin() -> None:
    table = space_table(1e-6)
    wide = replace(FIXED, tre_mm=4.0)
    draws, best = ErrorDraws.of(30, 5), table.best_entry()
    starts = table._scattered(best, wide, draws.entry)
    motions = table._error_in_plan(wide.rigid_error()).motions(draws.registration)
    found = table._reached(starts, Truths(motions, wide.ratios(draws.curvature)), 0)
    assert 3 < found.sum() < 27
    known = ~np.isnan(starts[:, 0])
    truths = np.concatenate([motions.reshape(-1, 12), wide.ratios(draws.curvature)[:, None]], -1)
    same = found[known] == space_twin(table, starts[known], truths[known])
    assert same.sum() >= known.sum() - 2


def late_agrees(found: Success, share: float, runs: int) -> bool:
    """Return whether the shares of two samples of executions differ by chance."""
    mean = (found.value * found.runs + share * runs) / (found.runs + runs)
    return abs(found.value - share) < SIGMAS * math.sqrt(mean * (1 - mean) * (1 / found.runs + 1 / runs))


@pytest.mark.parametrize("coil_mm", [0.0, 2.0, 9.0])
def test_tip_noise_that_is_known_late_costs_in_the_plane_what_it_costs_the_twin(
    plane: PolicyTable, coil_mm: float
) -> None:
    table = plan(replace(plane.scenario, needle=Needle(40.0)))
    start, runs = (0.0, 20.0, 0.3, -1), 300
    found = table.success_under(Uncertainty(coil_mm=coil_mm), start, executions=4000, seed=3)
    assert found.tip == found.together
    assert found.together.value < found.exact.value - 0.05
    assert late_agrees(found.together, late_in_plane(table, start, coil_mm, runs, 1), runs)


@pytest.mark.parametrize("coil_mm", [4.0, 15.0])
def test_tip_noise_that_is_known_late_costs_in_3d_what_it_costs_the_twin(coil_mm: float) -> None:
    text = TEXT.replace("radius_mm = 60.0", "radius_mm = 60.0\ntip_noise_deg = 8.0")
    table = plan_space(SpaceScenario.of(anatomy(box(), text)), threads=1)
    best, runs = table.best_entry().pose, 300
    found = table.success_under(Uncertainty(coil_mm=coil_mm), best, executions=4000, seed=3)
    pose = np.array([*best.position_mm, *best.tangent])
    assert late_agrees(found.together, late_in_3d(table, pose, coil_mm, runs, 1), runs)


def test_a_box_of_a_lattice_promises_as_the_whole(space: SpaceTable) -> None:
    moved = space.moved_to(space.scenario)
    assert outcomes(moved, ALL, space.best_entry(), 100, 1).tolist() == outcomes(
        space, ALL, space.best_entry(), 100, 1).tolist()  # fmt: skip


def test_the_name_is_public() -> None:
    promise = npl.plan("four_obstacles").success_under(Uncertainty(tre_mm=1.0), (0.0, 23.0, 0.5), executions=50)
    assert isinstance(promise, Promise)
    assert promise.exact.runs == 50


def test_an_entry_is_shifted_and_tilted_across_the_needle() -> None:
    table = plan_space(SpaceScenario.of(anatomy(box())), threads=1)
    start, errors = np.array(table.best_entry().pose), np.array([[2.0, 0.0], [0.0, 2.0], [1.0, -1.0]])
    shifted = scattered_space_poses(table.scenario, start, errors, np.zeros((3, 2)))[:, :3] - start[:3]
    across = shifted - np.outer(shifted @ start[3:], start[3:])
    np.testing.assert_allclose(across @ across.T, errors @ errors.T, atol=1e-9)
    tangents = scattered_space_poses(table.scenario, start, np.zeros((3, 2)), errors / 100)[:, 3:]
    sideways = tangents - np.outer(tangents @ start[3:], start[3:])
    np.testing.assert_allclose(sideways @ sideways.T, errors @ errors.T / 1e4, atol=1e-6)
