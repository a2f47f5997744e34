"""The tracer against dense sampling, boxes and arcs whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.blind.needle_executions import arc, bending_direction, disturb, transverse
from tests.blind.voxel_distance import Array, box_distances, centre_distances, segment_box_distances
from tests.blind.voxel_tracer import Ball, Path, Traces, Volume, trace

OBSTACLES = (7, 300)
EX, EY, EZ = np.eye(3)


def oblique(rng: np.random.Generator, spacing: Array, origin: Array) -> Array:
    affine = np.eye(4)
    affine[:3, :3] = np.linalg.qr(rng.standard_normal((3, 3)))[0] * spacing
    affine[:3, 3] = origin
    return affine


def needle_path(rng: np.random.Generator, point: Array, tangent: Array, steps: int, step_mm: float) -> Path:
    points, tangents, starts = [point], [tangent], []
    for _ in range(steps):
        starts.append(disturb(tangents[-1], step_mm, rng, 6.0))
        direction = bending_direction(starts[-1], rng.uniform(0.0, 2.0 * np.pi))
        radius = rng.choice([8.0, 60.0, np.inf])
        point, tangent = arc(points[-1], starts[-1], direction, radius, step_mm)
        points.append(point)
        tangents.append(tangent)
    return Path(np.array(points), np.array(tangents), np.array(starts))


def dense(path: Path, every_mm: float) -> tuple[Array, Array]:
    """Points on the circles of a path and their lengths, by the centres of the circles."""
    assert path.start_tangents is not None
    points, lengths, before = [], [], 0.0
    for start, tangent, end in zip(path.points[:-1], path.start_tangents, path.points[1:], strict=True):
        secant = end - start
        across = secant - (secant @ tangent) * tangent
        if np.linalg.norm(across) < 1e-9:
            length = np.linalg.norm(secant)
            place = np.linspace(0.0, length, int(length / every_mm) + 1)
            points.append(start + place[:, None] * tangent)
        else:
            inward = across / np.linalg.norm(across)
            radius = secant @ secant / (2.0 * secant @ inward)
            centre = start + radius * inward
            sine, cosine = secant @ tangent / radius, (centre - end) @ inward / radius
            angle = np.linspace(0.0, np.arctan2(sine, cosine), int(radius * np.arctan2(sine, cosine) / every_mm) + 1)
            points.append(centre + radius * (np.sin(angle)[:, None] * tangent - np.cos(angle)[:, None] * inward))
            place, length = radius * angle, radius * angle[-1]
        lengths.append(before + place)
        before += length
    return np.concatenate(points), np.concatenate(lengths)


def random_volume(rng: np.random.Generator, share: float) -> Volume:
    spacing = np.exp(rng.uniform(np.log(0.3), np.log(3.0), 3))
    shape = np.ceil(24.0 / spacing).astype(int)
    labels = rng.choice([0, 7, 300, 9], shape, p=[0.9 - share, share / 2, share / 2, 0.1]).astype(np.uint16)
    affine = oblique(rng, spacing, np.zeros(3))
    affine[:3, 3] = -affine[:3, :3] @ (0.5 * np.array(shape))
    return Volume(labels, affine, OBSTACLES)


@pytest.mark.parametrize("seed", range(12))
def test_paths_meet_what_dense_samples_meet(seed: int) -> None:
    rng = np.random.default_rng(seed)
    volume = random_volume(rng, 0.002)
    paths = []
    for _ in range(8):
        tangent = rng.standard_normal(3)
        tangent /= np.linalg.norm(tangent)
        paths.append(needle_path(rng, rng.uniform(-3.0, 3.0, 3) - 6.0 * tangent, tangent, 4, 3.0))
    ball = Ball((1.0, 2.0, 0.5), 3.0)
    traces, by_label = trace(volume, paths, ball, 1.0, 3.0), trace(volume, paths, 9, 0.0, 0.0)
    boxes = np.argwhere(volume.solid)
    for number, path in enumerate(paths):
        points, lengths = dense(path, 0.001)
        place = np.linalg.solve(volume.affine[:3, :3], (points - volume.affine[:3, 3]).T).T
        cells = np.floor(place + 0.5).astype(int)
        within = ((cells >= 0) & (cells < volume.labels.shape)).all(1)
        labels = np.where(within, volume.labels[tuple(np.where(within[:, None], cells, 0).T)], -1)
        blocked = np.isin(labels, OBSTACLES)
        assert traces.length_mm[number] == pytest.approx(lengths[-1], abs=1e-6)
        assert traces.inside_mm[number] == pytest.approx(0.001 * blocked.sum(), abs=0.02)
        if abs(traces.inside_mm[number]) > 0.1 or not traces.touches[number]:
            assert blocked.any() == traces.touches[number]
        for at_mm, met in (
            (traces.first_mm, blocked),
            (traces.leaves_mm, ~within),
            (by_label.target_mm, labels == 9),
            (traces.target_mm, np.linalg.norm(points - ball.center_mm, axis=1) <= ball.radius_mm),
        ):
            if met.sum() > 100:
                assert at_mm[number] == pytest.approx(lengths[met.argmax()], abs=0.01)
            elif not met.any():
                assert at_mm[number] == np.inf
        if blocked.sum() > 100:
            first = blocked.argmax()
            np.testing.assert_allclose(traces.first_point[number], points[first], atol=0.01)
            assert traces.first_voxel[number].tolist() == cells[first].tolist()
            assert traces.first_label[number] == labels[first]
        assert by_label.ends_in_target[number] == (labels[-1] == 9)
        sparse = np.append(place[::10], place[-1:], axis=0)
        gaps = sparse[:, None] * volume.spacing, (boxes - 0.5) * volume.spacing, (boxes + 0.5) * volume.spacing
        distance = box_distances(*gaps).min()
        if distance <= 2.99 and not traces.touches[number]:
            assert traces.nearest_mm[number] == pytest.approx(distance, abs=0.002)
            at = np.searchsorted(lengths, traces.nearest_at_mm[number])
            near = box_distances(place[min(at, len(place) - 1)] * volume.spacing, *gaps[1:]).min()
            assert near == pytest.approx(distance, abs=0.005)
    assert traces.kink_rad.max() < 1e-6


def one_voxel(affine: Array, voxel: tuple[int, int, int] = (5, 5, 5)) -> Volume:
    labels = np.zeros((11, 11, 11), np.uint8)
    labels[voxel] = 7
    return Volume(labels, affine, OBSTACLES)


def traced(volume: Volume, points: list[Array], tangent: Array, **options: float) -> Traces:
    """A path in the index frame of a volume, in mm along its axes."""
    world = volume.affine[:3, :3] / volume.spacing
    path = Path(np.array(points) @ world.T + volume.affine[:3, 3], np.tile(world @ tangent, (len(points), 1)))
    return trace(volume, [path], **options)


@pytest.fixture(params=range(4))
def affine(request: pytest.FixtureRequest) -> Array:
    rng = np.random.default_rng(request.param)
    return oblique(rng, np.array([0.4, 1.0, 2.5]), rng.uniform(-90.0, 90.0, 3))


def test_a_straight_path_meets_the_face_of_a_voxel(affine: Array) -> None:
    # Sides of voxel 5: 1.8 to 2.2 mm on the first axis, 4.5 to 5.5 mm on the second, 11.25 to 13.75 mm on the third.
    traces = traced(one_voxel(affine), [np.array([0.0, 5.2, 12.0]), np.array([4.0, 5.2, 12.0])], EX)
    assert traces.first_mm[0] == pytest.approx(1.8)
    assert traces.inside_mm[0] == pytest.approx(0.4)
    assert traces.first_voxel[0].tolist() == [5, 5, 5]
    assert traces.nearest_mm[0] == 0.0


@pytest.mark.parametrize("gap_mm", [-0.003, 0.003])
def test_an_arc_that_grazes_a_face(affine: Array, gap_mm: float) -> None:
    radius, half_angle = 60.0, 0.05
    top = np.array([2.0, 5.0, 13.75 + gap_mm])  # the lowest point of the arc, over the voxel
    start, end = (top + radius * np.array([0.0, np.sin(a), 1.0 - np.cos(a)]) for a in (-half_angle, half_angle))
    tangent = np.array([0.0, np.cos(half_angle), -np.sin(half_angle)])
    traces = traced(one_voxel(affine), [start, end], tangent)
    assert traces.touches[0] == (gap_mm < 0.0)
    assert traces.nearest_mm[0] == pytest.approx(max(gap_mm, 0.0), abs=0.001)
    assert traces.curvature_1_mm[0] == pytest.approx(1.0 / radius)


def test_the_body_overlaps_when_the_edge_is_nearer_than_the_radius(affine: Array) -> None:
    points = [np.array([2.2 + 0.3, 5.5 + 0.4, z]) for z in (2.0, 20.0)]
    for diameter, overlaps in ((0.999, False), (1.001, True)):
        traces = traced(one_voxel(affine), points, EZ, diameter_mm=diameter, reach_mm=0.0)
        assert traces.body_overlaps[0] == overlaps
        assert not traces.touches[0]
    assert traces.nearest_mm[0] == pytest.approx(0.5)
    assert np.isinf(traced(one_voxel(affine), points, EZ, reach_mm=0.49).nearest_mm[0])


def test_a_diagonal_between_two_voxels_is_seen_by_its_distance(affine: Array) -> None:
    labels = np.zeros((11, 11, 11), np.uint8)
    labels[5, 5, :] = labels[6, 6, :] = 7
    slip = np.array([2.2, 5.5, 12.0])
    course = np.array([0.4, -1.0, 0.0])
    traces = traced(Volume(labels, affine, OBSTACLES), [slip - course, slip + course], course / np.linalg.norm(course))
    assert traces.inside_mm[0] == pytest.approx(0.0, abs=1e-9)
    assert traces.nearest_mm[0] == pytest.approx(0.0, abs=1e-9)


def test_a_path_of_one_pose(affine: Array) -> None:
    traces = traced(one_voxel(affine), [np.array([2.0, 5.0, 12.0])], EX)
    assert traces.touches[0]
    assert traces.length_mm[0] == traces.first_mm[0] == 0.0


def test_points_without_tangents_are_joined_by_straight_lines(affine: Array) -> None:
    # Around the near corner of the voxel and back: one leg passes 0.1 mm beside it, the other meets its second face.
    local = np.array([[0.0, 4.4, 12.0], [3.0, 4.4, 12.0], [3.0, 4.4, 12.0], [2.0, 6.4, 12.0], [2.0, 5.0, 12.0]])
    world = local @ (affine[:3, :3] / np.linalg.norm(affine[:3, :3], axis=0)).T + affine[:3, 3]
    traces = trace(one_voxel(affine), [Path(world), Path(world[:2])])
    legs = 3.0 + np.hypot(1.0, 2.0) + 1.4
    assert traces.length_mm.tolist() == pytest.approx([legs, 3.0])
    assert traces.first_mm[0] == pytest.approx(legs - 0.5)
    assert traces.touches.tolist() == [True, False]
    assert traces.nearest_mm[1] == pytest.approx(0.1)
    assert 1.8 - 1e-9 <= traces.nearest_at_mm[1] <= 2.2 + 1e-9
    assert traces.curvature_1_mm.max() < 1e-6


def test_sheared_axes_are_refused() -> None:
    affine = np.eye(4)
    affine[0, 1] = 0.1
    with pytest.raises(ValueError, match="perpendicular"):
        Volume(np.zeros((2, 2, 2), np.uint8), affine)


def test_distances_of_segments_to_boxes() -> None:
    rng = np.random.default_rng(0)
    start, end = rng.uniform(-3.0, 3.0, (2, 500, 3))
    end[:50] = start[:50]
    end[50:150, 0] = start[50:150, 0]
    low = rng.uniform(-2.0, 0.0, (500, 3))
    high = low + rng.uniform(0.1, 2.0, (500, 3))
    distance, share = segment_box_distances(start, end, low, high)
    shares = np.linspace(0.0, 1.0, 2001)[:, None, None]
    expected = box_distances(start + shares * (end - start), low, high).min(0)
    np.testing.assert_allclose(distance, expected, atol=0.003)
    assert (distance <= expected + 1e-9).all()
    np.testing.assert_allclose(box_distances(start + share[:, None] * (end - start), low, high), distance, atol=1e-12)


def test_distances_of_centres() -> None:
    rng = np.random.default_rng(0)
    mask, spacing = rng.random((12, 9, 14)) < 0.01, np.array([0.5, 1.3, 0.4])
    boxes, centres = np.argwhere(mask) * spacing, np.argwhere(np.ones_like(mask)) * spacing
    expected = box_distances(centres[:, None], boxes - 0.5 * spacing, boxes + 0.5 * spacing).min(1).reshape(mask.shape)
    distance = centre_distances(mask, spacing, 2.0)
    near = expected < 2.0
    np.testing.assert_allclose(distance[near], expected[near], atol=1e-5)
    assert (distance[~near] >= 1.999).all()


def test_tip_noise_has_its_standard_deviation_in_both_directions() -> None:
    tangent = np.array([0.6, 0.0, 0.8])
    turned = disturb(np.tile(tangent, (40_000, 1)), 2.5, np.random.default_rng(0), 4.0)
    angle = np.arccos(np.clip(turned @ tangent, -1.0, 1.0))
    for direction in transverse(tangent):
        aside = turned @ direction * angle / np.sin(angle)
        assert np.rad2deg(aside.std()) == pytest.approx(2.0, rel=0.02)
        assert abs(np.rad2deg(aside.mean())) < 0.05
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1.0)


def test_half_a_circle() -> None:
    points, tangents = arc(np.zeros(3), EX, EY, 50.0, np.pi * np.array([0.0, 25.0, 50.0]))
    np.testing.assert_allclose(points, [[0.0, 0.0, 0.0], [50.0, 50.0, 0.0], [0.0, 100.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(tangents, [EX, EY, -EX], atol=1e-12)
