"""Executions of a needle in the continuous bicycle model: a path open loop, a path followed, a policy.

All of them have the same noise: after every `step_mm` of insertion the heading changes by m * `cell_rad`, and m is 0,
+-1, +-2 ... with the probabilities `tip_noise`. The module uses nothing of needleplan; a policy is a function from
poses to bevels.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from rrt_arcs import Array, Event, Space, advance
from rrt_scenes import RADIUS_MM

Arc = tuple[int, float]
# Bevels before the decision and poses -> bevels after it.
Decide = Callable[[Array, Array], Array]
# A policy that has inserted this length fails.
LONGEST_MM = 600.0
# Spacing of the points at which a path is measured (mm).
_SPACING_MM = 0.1


@dataclass(frozen=True)
class Noise:
    """Tip noise: probabilities of 0, +-1, +-2 ... cells after each step; `(1.0,)` is none."""

    step_mm: float
    cell_rad: float
    tip_noise: tuple[float, ...] = (1.0,)

    def draw(self, random: np.random.Generator, size: int) -> Array:
        """Return changes of the heading in rad."""
        half = np.array(self.tip_noise)
        cells = np.arange(1 - len(half), len(half))
        odds = np.concatenate([half[:0:-1], half])
        return random.choice(cells, size=size, p=odds / odds.sum()) * self.cell_rad


@dataclass(frozen=True)
class Travelled:
    """Many executions: how each one ended, its inserted length and its turns."""

    event: NDArray[np.int64]
    length_mm: Array
    turns: NDArray[np.int64]

    @property
    def success(self) -> float:
        """Share of the executions that reached the target."""
        return float((self.event == Event.TARGET).mean())


@dataclass(frozen=True)
class Measured:
    """One path without noise, tested exactly."""

    event: Event
    length_mm: float
    turns: int
    clearance_mm: float


def measured(space: Space, arcs: Sequence[Arc]) -> Measured:
    """Execute arcs without noise; the clearance is that to the obstacles without their margin, within 0.05 mm."""
    pose = np.array([space.scene.start])
    inserted, turns, points = 0.0, -1, [pose[:, :2]]
    event = Event.NONE
    before = 0
    for bevel, length in arcs:
        turns += bevel != before
        before = bevel
        signs = np.array([float(bevel)])
        while length > 1e-9 and event == Event.NONE:
            part = min(length, RADIUS_MM)
            found, reached = space.events(pose, signs, part)
            event, part = Event(int(found[0])), float(reached[0])
            along = np.linspace(0, part, int(part / _SPACING_MM) + 2)[1:]
            line = advance(np.repeat(pose, len(along), axis=0), np.repeat(signs, len(along)), along)
            points.append(line[:, :2])
            pose = line[-1:]
            inserted += part
            length -= part
        if event != Event.NONE:
            break
    distance = shapely.distance(shapely.points(np.concatenate(points)), space.scene.anatomy).min()
    return Measured(event, inserted, max(turns, 0), float(distance))


def policy_arcs(space: Space, decide: Decide, bevel: int, step_mm: float) -> list[Arc]:
    """Return the arcs of one execution of a policy without noise, up to its end; steps of one bevel are merged."""
    pose, signs = np.array([space.scene.start]), np.array([float(bevel)])
    arcs: list[Arc] = []
    while sum(length for _, length in arcs) < LONGEST_MM:
        signs = decide(pose, signs)
        same = bool(arcs) and arcs[-1][0] == signs[0]
        before = arcs.pop()[1] if same else 0.0
        arcs.append((int(signs[0]), before + step_mm))
        if space.events(pose, signs, step_mm)[0][0] != Event.NONE:
            break
        pose = advance(pose, signs, step_mm)
    return arcs


def policy(space: Space, decide: Decide, bevel: int, noise: Noise, runs: int, seed: int) -> Travelled:
    """Execute a policy closed loop: it decides at the true pose before every step."""

    def steps(poses: Array, signs: Array, _: int) -> tuple[Array, float, bool]:
        return decide(poses, signs), noise.step_mm, True

    return _travel(space, steps, float(bevel), noise, runs, seed)


def open_loop(space: Space, arcs: Sequence[Arc], noise: Noise, runs: int, seed: int) -> Travelled:
    """Execute the controls of a path, whatever the noise does. A path that ends before the target has failed."""
    pieces: list[tuple[int, float, bool]] = []
    until_noise = noise.step_mm
    for bevel, length in arcs:
        while length > 1e-9:
            part = min(length, until_noise)
            length -= part
            until_noise -= part
            disturbed = until_noise <= 1e-9
            until_noise = noise.step_mm if disturbed else until_noise
            pieces.append((bevel, part, disturbed))

    def steps(poses: Array, _: Array, index: int) -> tuple[Array, float, bool]:
        if index >= len(pieces):
            return np.zeros(0), 0.0, False
        bevel, part, disturbed = pieces[index]
        return np.full(len(poses), float(bevel)), part, disturbed

    return _travel(space, steps, float(arcs[0][0]), noise, runs, seed)


def following(arcs: Sequence[Arc], start: tuple[float, float, float], step_mm: float) -> Decide:
    """Return a policy that follows a path: the bevel whose next pose is closest to the path, one step ahead.

    The reference is the pose of the path one step after the place that is nearest to the tip. The distance of two poses
    is the sum of two squared distances: between the positions, and between the points 10 mm ahead of them.
    """
    pose, line = np.array([start]), []
    for bevel, length in arcs:
        along = np.linspace(0, length, int(length / _SPACING_MM) + 2)
        signs = np.full(len(along), float(bevel))
        line.append(advance(np.repeat(pose, len(along), axis=0), signs, along))
        pose = line[-1][-1:]
    path = np.concatenate(line)
    ahead = int(step_mm / _SPACING_MM)

    def decide(poses: Array, _: Array) -> Array:
        apart = (poses[:, None, 0] - path[:, 0]) ** 2 + (poses[:, None, 1] - path[:, 1]) ** 2
        wanted = path[np.minimum(apart.argmin(axis=1) + ahead, len(path) - 1)]
        off = [_apart(advance(poses, np.full(len(poses), sign), step_mm), wanted) for sign in (-1.0, 1.0)]
        return np.where(off[0] < off[1], -1.0, 1.0)

    return decide


def _apart(poses: Array, others: Array) -> Array:
    def near_and_far(each: Array) -> Array:
        way = 10 * np.column_stack([np.cos(each[:, 2]), np.sin(each[:, 2])])
        return np.hstack([each[:, :2], each[:, :2] + way])

    return np.asarray(((near_and_far(poses) - near_and_far(others)) ** 2).sum(axis=1))


def _travel(
    space: Space,
    steps: Callable[[Array, Array, int], tuple[Array, float, bool]],
    bevel: float,
    noise: Noise,
    runs: int,
    seed: int,
) -> Travelled:
    random = np.random.default_rng(seed)
    poses = np.tile(np.array(space.scene.start), (runs, 1))
    signs = np.full(runs, bevel)
    event = np.zeros(runs, dtype=np.int64)
    length, turns = np.zeros(runs), np.zeros(runs, dtype=np.int64)
    index = 0
    while (on := np.flatnonzero(event == Event.NONE)).size and length[on[0]] < LONGEST_MM:
        bevels, part, disturbed = steps(poses[on], signs[on], index)
        if part == 0.0:
            break
        turns[on] += bevels != signs[on]
        signs[on] = bevels
        found, reached = space.events(poses[on], bevels, part)
        poses[on] = advance(poses[on], bevels, reached)
        length[on] += reached
        event[on] = found
        changes = noise.draw(random, runs)  # for all runs, so that the noise of a run does not depend on the others
        if disturbed:
            poses[on, 2] += changes[on]
        index += 1
    return Travelled(event, length, turns)
