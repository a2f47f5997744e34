"""A slow, plain twin of the 3D planner: one backward pass, written from the mathematics and not from the solver.

A state is a slice i, a direction d, a grid point (j, k) of the slice; every step of an action leads to slice i + m.

1. Directions: the points (u, v) of a square grid within the cone; theta = |(u, v)| is the angle from the axis x, and
   e = (u, v) / theta the azimuth. Two vectors across a tangent t are those of y and z after the rotation of x
   to t (parallel transport). Roll angle number a of n bends towards cos(2 pi a / n) and sin(2 pi a / n) of them.
2. A step is an arc of the curvature c from the grid point to the plane m slices ahead. The noise disturbs its tangent
   at the plane after the share 1 - 1 / sqrt(3) of the way, so the step has branches. Each part is a polygon of S equal
   arcs, S = ceil(4 m dx / sqrt(3) / cos(cone) / smallest spacing). It passes the voxels between all its crossings of
   faces; the voxel of a point is that around the nearest grid point. The first voxel that is not free ends the
   execution.
3. Without noise the step of the length L would end with the tangent t. The noise has the variance q L in each of two
   directions across it. In (u, v) its covariance is q L (e e' + (theta / sin theta)^2 (1 - e e')). On each axis the
   nearest grid point and those r cells to both sides have the mean f and the variance S in cells:
   (S + f^2 +- r f) / (2 r^2), r = max(1, round(sqrt(3 S))), S at least |f| (r - |f|). The covariance goes to the
   corners, +-C / (4 r r'), as far as no weight is negative. The points within the cone are the branches. The part of a
   normal distribution beyond the rim is lost by each branch that lands.
4. A branch is the second part of the arc, turned about the end of the first by the shortest rotation of t to its
   direction; of the way to it along u and v, only the share of the noise in S counts. It lands at the y of the branch
   with the same u and the mean v, and at the z of that with the same v and the mean u.
5. The landing is shared bilinearly among four grid points; those beyond the grid cost `exit`. A grid point that is not
   free has the value of an execution that starts there and leaves its voxel.
6. A state is open if a step leads from it into the target or to a landing with an open state among its four grid
   points. A state that is not open ends at the cost `exit`.
7. V = min over actions of the cost of the step, the price of its start, and what follows. Success: of the best action.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FREE, TARGET, OBSTACLE, OUTSIDE = 0, 1, 2, 3
DISTURBED_AT = 1 - 1 / math.sqrt(3)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class SpaceCase:
    """A problem; lengths in mm, angles in rad. `straight` is (share of the curvature, cost of a mm)."""

    voxels: NDArray[np.uint8]
    spacing: tuple[float, float, float]
    radius: float
    advance: int
    rolls: int
    cone: float
    step: float  # spacing of the directions
    noise: float  # after 1 mm
    insertion: float
    rotation: float
    collision: float
    exit: float
    prices: NDArray[np.float32]
    straight: tuple[float, float] | None = None


def directions(case: SpaceCase) -> list[tuple[int, int]]:
    reach = int(case.cone / case.step + 1e-9)
    cells = range(-reach, reach + 1)
    return [(u, v) for u in cells for v in cells if math.hypot(u, v) * case.step <= case.cone + 1e-9]


def tangent(case: SpaceCase, cell: tuple[int, int]) -> Floats:
    u, v = cell[0] * case.step, cell[1] * case.step
    theta = math.hypot(u, v)
    azimuth = math.atan2(v, u)
    return np.array([math.cos(theta), math.sin(theta) * math.cos(azimuth), math.sin(theta) * math.sin(azimuth)])


def across(t: Floats, roll: float) -> Floats:
    """The vector across t at a roll angle: rotated from the axis with Rodrigues' formula."""
    start = np.array([0.0, math.cos(roll), math.sin(roll)])
    pole = np.cross([1.0, 0.0, 0.0], t)
    sine, cosine = float(np.linalg.norm(pole)), t[0]
    if sine < 1e-12:
        return start
    pole = pole / sine
    turned: Floats = start * cosine + np.cross(pole, start) * sine + pole * np.dot(pole, start) * (1 - cosine)
    return turned


def arc(t: Floats, normal: Floats, curvature: float, s: Floats) -> Floats:
    """Positions after the arc lengths s, [n, 3]."""
    if curvature < 1e-12:
        return s[:, None] * t
    angle = curvature * s[:, None]
    positions: Floats = (np.sin(angle) * t + (1 - np.cos(angle)) * normal) / curvature
    return positions


def length_to(t: Floats, normal: Floats, curvature: float, advance: float) -> float | None:
    """Arc length at which the plane is first reached, by bisection up to the turning point."""
    turning = math.atan2(t[0], -normal[0]) / curvature if curvature > 1e-12 else advance / t[0] + 1.0

    def reached(s: float) -> float:
        return float(arc(t, normal, curvature, np.array([s]))[0, 0])

    low, high = 0.0, turning
    if reached(high) < advance:
        return None
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if reached(middle) < advance else (low, middle)
    return high


def rotated(v: Floats, a: Floats, b: Floats) -> Floats:
    """Return v after the shortest rotation of the unit vector a to b, with Rodrigues' formula."""
    pole = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(pole)), float(a @ b)
    if sine < 1e-15:
        return v
    pole = pole / sine
    turned: Floats = v * cosine + np.cross(pole, v) * sine + pole * np.dot(pole, v) * (1 - cosine)
    return turned


def pointing(u: float, v: float) -> Floats:
    theta, azimuth = math.hypot(u, v), math.atan2(v, u)
    return np.array([math.cos(theta), math.sin(theta) * math.cos(azimuth), math.sin(theta) * math.sin(azimuth)])


def marginal(mean: float, variance: float) -> tuple[list[tuple[int, float]], float]:
    """Cells with their weights, and the share of the noise in their variance."""
    centre = math.floor(mean + 0.5)
    f, r = mean - centre, max(1, math.floor(math.sqrt(3 * variance) + 0.5))
    raised = max(variance, abs(f) * (r - abs(f)))
    low, high = ((raised + f * f + side * r * f) / (2 * r * r) for side in (-1, 1))
    return [(centre - r, low), (centre, 1 - low - high), (centre + r, high)], variance / raised if raised > 0 else 0.0


Numbers = dict[tuple[int, int], int]


@dataclass(frozen=True)
class Stencil:
    taps: dict[tuple[int, int], tuple[int, float]]  # direction and weight by place, (0 to 2, 0 to 2)
    kicked: list[list[Floats]]  # the mean tangent after the disturbance of each place
    lost: float


def stencil(case: SpaceCase, number: Numbers, t: Floats, variance: float) -> Stencil:
    """The directions after a step that would end with the tangent t."""
    theta = math.atan2(math.hypot(t[1], t[2]), t[0])
    e = np.array([1.0, 0.0]) if theta < 1e-6 else np.array([t[1], t[2]]) / math.hypot(t[1], t[2])
    lost = 0.5 * math.erfc((case.cone - theta) / math.sqrt(2 * variance)) if variance > 0 else float(theta > case.cone)
    lost = 0.0 if lost < 1e-7 else lost
    stretch = (theta / math.sin(theta)) ** 2 if theta > 1e-6 else 1.0
    covariance = variance / case.step**2 * (np.outer(e, e) + stretch * (np.eye(2) - np.outer(e, e)))
    mean = theta * e if theta >= 1e-6 else np.array([t[1], t[2]])
    (us, of_u), (vs, of_v) = (marginal(mean[axis] / case.step, covariance[axis, axis]) for axis in (0, 1))
    weights = np.outer([w for _, w in us], [w for _, w in vs])
    corner = covariance[0, 1] / (4 * (us[2][0] - us[1][0]) * (vs[2][0] - vs[1][0]))
    corner = max(min(corner, weights[0, 2], weights[2, 0]), -min(weights[0, 0], weights[2, 2]))
    weights += corner * np.outer([-1, 0, 1], [-1, 0, 1])
    kicked = [
        [
            pointing(mean[0] + of_u * (u * case.step - mean[0]), mean[1] + of_v * (v * case.step - mean[1]))
            for v, _ in vs
        ]
        for u, _ in us
    ]
    taps = {
        (a, b): (number[us[a][0], vs[b][0]], float(weights[a, b]))
        for a in range(3)
        for b in range(3)
        if (us[a][0], vs[b][0]) in number and weights[a, b] > 0
    }
    total = sum(weight for _, weight in taps.values())
    if total < 1e-7 or lost > 1 - 1e-7:
        return Stencil({}, kicked, 1.0)
    return Stencil({place: (d, w / total) for place, (d, w) in taps.items()}, kicked, lost)


def look(volume: Floats, beyond: float, dj: int, dk: int) -> Floats:
    """The plane read at an offset from each point, [..., j, k]."""
    moved = np.full_like(volume, beyond)
    ny, nz = volume.shape[-2:]
    j0, j1, k0, k1 = max(0, -dj), min(ny, ny - dj), max(0, -dk), min(nz, nz - dk)
    if j0 < j1 and k0 < k1:
        moved[..., j0:j1, k0:k1] = volume[..., j0 + dj : j1 + dj, k0 + dk : k1 + dk]
    return moved


@dataclass(frozen=True)
class Branch:
    direction: int
    weight: float
    path: Ints  # voxels that it passes, the last one that of the landing
    landing: Floats  # in voxels, along y and z


@dataclass(frozen=True)
class Step:
    cost: float
    length: float
    path: Ints  # voxels that all branches pass
    branches: list[Branch]
    lost: float  # of what a branch lands with


def voxels(case: SpaceCase, points: Floats) -> Ints:
    """The voxels of a polygon, without that of its first point: those at the middles between all crossings of faces."""
    found = [np.floor(points[0] / case.spacing + 0.5).astype(int)]
    for a, b in itertools.pairwise(points / case.spacing + 0.5):
        shares = {0.0, 1.0}
        for axis in range(3):
            low, high = sorted((a[axis], b[axis]))
            faces = range(math.floor(low), math.ceil(high) + 1)
            shares |= {(face - a[axis]) / (b[axis] - a[axis]) for face in faces if low < face < high}
        ordered = sorted(shares)
        middles = [a + 0.5 * (s + t) * (b - a) for s, t in itertools.pairwise(ordered) if t - s > 1e-12]
        for cell in [*(np.floor(middle).astype(int) for middle in middles), np.floor(b).astype(int)]:
            if np.any(cell != found[-1]):
                found.append(cell)
    return np.array(found[1:], dtype=np.int64).reshape(-1, 3)


def step(case: SpaceCase, number: Numbers, samples: int, cell: tuple[int, int], action: int) -> Step:
    t, advance = tangent(case, cell), case.advance * case.spacing[0]
    share, per_mm, turning, roll = 1.0, case.insertion, case.rotation, 2 * math.pi * action / case.rolls
    if case.straight is not None and action == case.rolls:
        (share, per_mm), turning, roll = case.straight, 0.0, 0.0
    normal, curvature = across(t, roll), share / case.radius
    length, first = (length_to(t, normal, curvature, x) for x in (advance, DISTURBED_AT * advance))
    if length is None or first is None:
        whole = advance / t[0]
        return Step(per_mm * whole + turning, whole, np.zeros((0, 3), dtype=np.int64), [], 1.0)
    angle = curvature * first
    middle = arc(t, normal, curvature, np.array([first]))[0]
    at_middle = math.cos(angle) * t + math.sin(angle) * normal, math.cos(angle) * normal - math.sin(angle) * t
    mean = math.cos(curvature * length) * t + math.sin(curvature * length) * normal
    found = stencil(case, number, mean, case.noise**2 * length)

    def branch(a: int, b: int) -> Floats | None:
        tip, bend = (rotated(each, mean, found.kicked[a][b]) for each in at_middle)
        rest = length_to(tip, bend, curvature, advance - middle[0])
        return None if rest is None else middle + arc(tip, bend, curvature, rest * np.arange(1, samples + 1) / samples)

    branches = []
    for (a, b), (direction, weight) in found.taps.items():
        path, of_y, of_z = branch(a, b), branch(a, 1), branch(1, b)
        assert path is not None
        assert of_y is not None
        assert of_z is not None
        path[-1] = advance, of_y[-1, 1], of_z[-1, 2]
        landing = np.array([path[-1, axis] / case.spacing[axis] for axis in (1, 2)])
        landing = np.where(abs(landing - np.round(landing)) < 1e-9, np.round(landing), landing)
        last = np.array([case.advance, *np.floor(landing + 0.5)], dtype=np.int64)
        branches.append(Branch(direction, weight, np.vstack([voxels(case, np.vstack([middle, path])), last]), landing))
    path = arc(t, normal, curvature, first * np.arange(samples + 1) / samples)
    return Step(per_mm * length + turning, length, voxels(case, path), branches, found.lost)


def ends(case: SpaceCase, i: int, path: Ints, ended: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The code of the first voxel of a path that is not free, for each start of slice i, unless it has ended before."""
    slices, ny, nz = case.voxels.shape
    for a, b, c in path:
        met = look(case.voxels[i + a], OUTSIDE, b, c) if i + a < slices else np.full((ny, nz), OUTSIDE)
        ended = np.where(ended == FREE, met, ended).astype(np.uint8)
    return ended


def landings(case: SpaceCase, read: tuple[Floats, Floats, Floats], branch: Branch) -> tuple[Floats, Floats, Floats]:
    """Value and success where a branch lands, and whether an open state is read there, for each start."""
    values, success, is_open = (each[branch.direction] for each in read)
    (j, fj), (k, fk) = ((math.floor(x), x - math.floor(x)) for x in branch.landing)
    landed, reached, leads = np.zeros(values.shape), np.zeros(values.shape), np.zeros(values.shape)
    for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
        w = (fj if a else 1 - fj) * (fk if b else 1 - fk)
        landed += w * look(values, case.exit, j + a, k + b)
        reached += w * look(success, 0.0, j + a, k + b)
        leads = np.maximum(leads, look(is_open, 0.0, j + a, k + b))
    return landed, reached, leads


def solve(case: SpaceCase) -> tuple[Floats, Ints, Floats]:
    """Values, policy and success, [slice, direction, j, k]."""
    cells = directions(case)
    number = {cell: index for index, cell in enumerate(cells)}
    slices, ny, nz = case.voxels.shape
    dx = case.spacing[0]
    failure = np.array([0.0, 0.0, case.collision, case.exit])
    actions = case.rolls + (case.straight is not None)
    samples = math.ceil(4 * (1 - DISTURBED_AT) * case.advance * dx / math.cos(case.cone) / min(case.spacing))
    values = np.zeros((slices, len(cells), ny, nz))
    success = np.zeros_like(values)
    policy = np.zeros(values.shape, dtype=np.int64)
    is_open = np.zeros_like(values)
    read: dict[int, tuple[Floats, Floats, Floats]] = {}
    steps = [[step(case, number, samples, cell, action) for action in range(actions)] for cell in cells]
    for i in reversed(range(slices)):
        for d in range(len(cells)):
            best = np.full((ny, nz), np.inf)
            for action, made in enumerate(steps[d]):
                common = ends(case, i, made.path, np.zeros((ny, nz), dtype=np.uint8))
                after, chance = np.zeros((ny, nz)), np.zeros((ny, nz))
                for branch in made.branches:
                    ended = ends(case, i, branch.path, common)
                    landed, reached, leads = np.full((ny, nz), case.exit), np.zeros((ny, nz)), np.zeros((ny, nz))
                    if i + case.advance < slices:
                        landed, reached, leads = landings(case, read[i + case.advance], branch)
                        landed = made.lost * case.exit + (1 - made.lost) * landed
                        reached = (1 - made.lost) * reached
                    after += branch.weight * np.where(ended == FREE, landed, failure[ended])
                    chance += branch.weight * np.where(ended == FREE, reached, ended == TARGET)
                    is_open[i, d] = np.maximum(is_open[i, d], np.where(ended == FREE, leads, ended == TARGET))
                if not made.branches:
                    after = np.where(common == FREE, case.exit, failure[common])
                    chance = (common == TARGET).astype(float)
                    is_open[i, d] = np.maximum(is_open[i, d], chance)
                total = made.cost + made.length * case.prices[i] + after
                better = total < best
                best = np.where(better, total, best)
                policy[i, d][better] = action
                success[i, d][better] = chance[better]
            closed = is_open[i, d] == 0.0
            best[closed], policy[i, d][closed], success[i, d][closed] = case.exit, 0, 0.0
            values[i, d] = best
        read[i] = values[i], success[i], is_open[i]
    return values, policy, success
