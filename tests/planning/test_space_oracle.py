"""The compiled pass in 3D beside its slow twin, and predictions beside executions, from Python."""

import numpy as np
import oracle_space as oracle
import pytest

from needleplan import _ppvi


def case(seed: int, straight: tuple[float, float] | None, noise: float) -> oracle.SpaceCase:
    random = np.random.default_rng(seed)
    voxels = np.zeros((6, 7, 8), dtype=np.uint8)
    voxels[random.random(voxels.shape) < 0.04] = oracle.OBSTACLE
    voxels[random.random(voxels.shape) < 0.01] = oracle.OUTSIDE
    voxels[4:, 3:5, 3:6] = oracle.TARGET
    return oracle.SpaceCase(
        voxels=voxels,
        spacing=(2.0, 1.5, 1.75),
        radius=18.0,
        advance=2,
        rolls=4,
        cone=0.5,
        step=0.2,
        noise=noise,
        insertion=1.0,
        rotation=0.5,
        collision=1000.0,
        exit=700.0,
        prices=random.random(voxels.shape).astype(np.float32),
        straight=straight,
    )


def compiled(problem: oracle.SpaceCase) -> _ppvi.Space:
    return _ppvi.Space(
        voxels=problem.voxels,
        spacing_mm=problem.spacing,
        curvature_radii_mm=[problem.radius],
        advance=problem.advance,
        rolls=problem.rolls,
        cone_rad=problem.cone,
        direction_spacing_rad=problem.step,
        noise_rad_per_sqrt_mm=problem.noise,
        insertion_per_mm=problem.insertion,
        rotation=problem.rotation,
        collision=problem.collision,
        exit=problem.exit,
        prices=problem.prices,
        straight=problem.straight,
    )


@pytest.mark.slow
@pytest.mark.study
@pytest.mark.parametrize(("straight", "noise"), [pytest.param((0.25, 1.3), 0.05, marks=pytest.mark.slow), (None, 0.02)])
def test_the_pass_agrees_with_its_twin(straight: tuple[float, float] | None, noise: float) -> None:
    problem = case(5, straight, noise)
    values, policy, success = oracle.solve(problem)
    space = compiled(problem)
    tangents = [oracle.tangent(problem, cell) for cell in oracle.directions(problem)]
    np.testing.assert_allclose(space.tangents(), tangents, atol=1e-12)
    solved = space.solve(cubic_success=False)
    assert solved.report()["status"] == "converged"
    np.testing.assert_allclose(solved.values, values, rtol=2e-5, atol=1e-3)
    same = solved.policy == policy
    # The values agree, so actions differ only where two cost the same.
    assert same.mean() > 0.995
    np.testing.assert_allclose(solved.success[same] / 65535, success[same], atol=1e-3)
    assert 0.05 < success.mean() < 0.95


def test_poses_are_looked_up_and_executed() -> None:
    problem = case(5, (0.25, 1.3), 0.03)
    space = compiled(problem)
    solved = space.solve()
    start = np.array([[0.0, 5.0, 7.0, 1.0, 0.0, 0.1]])
    found = solved.look_up(start)
    assert found["action"][0] <= 4
    assert found["value"][0] > 0.0
    assert 0.0 <= found["success"][0] <= 1.0
    assert solved.decide(start) == {name: found[name] for name in ("action", "value")}
    runs = solved.rollout(start, runs=200, seed=1)
    assert abs((runs["outcome"] == 1).mean() - found["success"][0]) < 0.25
    again = solved.rollout(start, runs=200, seed=1, threads=1)
    np.testing.assert_array_equal(runs["cost"], again["cost"])
    with pytest.raises(ValueError, match=r"poses: expected shape \[n, 6\]"):
        solved.look_up(start[:, :4].copy())
    with pytest.raises(ValueError, match="in the cone"):
        solved.look_up(np.array([[0.0, 5.0, 7.0, 1.0, 1.0, 0.0]]))
