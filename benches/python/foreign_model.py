"""A second model of needle and policy, written from the documentation, with numpy and without needleplan.

It shares no code with the planner, its executions or their oracle. The sources were the pages `planner.md`,
`scenario.md`, `table.md` and `choose-transition.md`. All functions take arrays with one entry for each run.

Arcs and their events are exact. With the tangent u, the normal v and the signed curvature k, the point of an arc at the
length s is p + u sin(k s) / k + v (1 - cos(k s)) / k. With w = tan(k s / 2) / k (w = s / 2 on a straight path), the arc
meets the line n . z = n . a, and the circle of centre c and radius R, where

    k (2 n.v - C k) w^2 + 2 n.u w - C = 0,                        C = n . (a - p)
    (D k^2 + 4 k d.v + 4) w^2 + 4 d.u w + D = 0,                  d = p - c, D = d . d - R^2

Both equations hold for k = 0 as well. A shape with a margin is the union of the shape and a capsule around each edge.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

NONE, TARGET, COLLISION, EXIT = range(4)
PIECES = 4  # pieces of one curvature in a step, where there are layers or tissues
MOST_STEPS = 3000  # steps after which an execution counts as a failure


@dataclass(frozen=True)
class Shape:
    """Polygon with holes, disc (one point) or capsule (two points): all points within `reach` of it."""

    rings: list[np.ndarray]
    points: np.ndarray  # [n, 2], ends of the edges in order, or the centre
    edges: np.ndarray  # [m, 2, 2]
    reach: float

    @classmethod
    def read(cls, table: dict[str, Any]) -> Shape:
        """Return the shape of an `[[obstacle]]` or a `[[tissue]]`."""
        margin = table.get("margin_mm", 0.0)
        if "polygon_mm" in table:
            rings = [np.array(ring, float) for ring in (table["polygon_mm"], *table.get("holes_mm", []))]
            edges = np.concatenate([np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings])
            return cls(rings, np.concatenate(rings), edges, margin)
        if "ends_mm" in table:
            ends = np.array(table["ends_mm"], float)
            return cls([], ends, ends[None], table["radius_mm"] + margin)
        return cls([], np.array([table["center_mm"]], float), np.empty((0, 2, 2)), table["radius_mm"] + margin)

    def holds(self, p: np.ndarray) -> np.ndarray:
        """Return whether each point [n, 2] is in the shape or on its boundary."""
        inside = np.zeros(len(p), bool)
        for ring in self.rings:
            for (ax, ay), (bx, by) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
                if ay != by:
                    across = (ay > p[:, 1]) != (by > p[:, 1])
                    inside ^= across & (p[:, 0] < ax + (p[:, 1] - ay) * (bx - ax) / (by - ay))
        near = (np.hypot(*(p[:, None] - self.points).transpose(2, 0, 1)) <= self.reach).any(axis=1)
        for a, b in self.edges:
            t = np.clip(((p - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
            near |= np.hypot(*(p - a - t[:, None] * (b - a)).T) <= self.reach
        return inside | near

    def boundary(self) -> tuple[np.ndarray, np.ndarray]:
        """Return segments [m, 2, 2] and circles [n, 3] of which the outermost parts are the boundary."""
        if self.reach == 0.0:
            return self.edges, np.empty((0, 3))
        circles = np.column_stack([self.points, np.full(len(self.points), self.reach)])
        if not len(self.edges):
            return self.edges, circles
        along = self.edges[:, 1] - self.edges[:, 0]
        offset = np.column_stack([-along[:, 1], along[:, 0]]) * (self.reach / np.hypot(*along.T))[:, None]
        return np.concatenate([self.edges + offset[:, None], self.edges - offset[:, None]]), circles


class Model:
    """The continuous model of a scenario: arcs, events, costs and noise."""

    def __init__(self, text: str) -> None:
        scenario = tomllib.loads(text)
        motion, needle, goal = scenario["motion"], scenario["needle"], scenario["objective"]
        if motion.get("arc_samples") is not None or goal.get("clearance_mm") is not None:
            raise SystemExit("the foreign model has neither motion.arc_samples nor objective.clearance_mm")
        self.width, self.height = scenario["workspace"]["width_mm"], scenario["workspace"]["height_mm"]
        self.obstacles = [Shape.read(each) for each in scenario.get("obstacle", [])]
        parts = [each.boundary() for each in self.obstacles]
        self.segments = np.concatenate([np.empty((0, 2, 2)), *(segments for segments, _ in parts)])
        self.circles = np.concatenate([np.empty((0, 3)), *(circles for _, circles in parts)])
        self.target = np.array([[*scenario["target"]["center_mm"], scenario["target"]["radius_mm"]]])
        self.curvature = 1.0 / needle["curvature_radius_mm"]
        self.layers = [(each["from_mm"], 1.0 / each["curvature_radius_mm"]) for each in needle.get("layer", [])]
        self.tissues = [(Shape.read(each), 1.0 / each["curvature_radius_mm"]) for each in scenario.get("tissue", [])]
        self.cell = 2.0 * math.pi / motion["headings"]
        self.step = motion.get("step_mm")
        half = motion["tip_noise"]
        reach = np.arange(len(half))
        self.noise_step = math.radians(motion["tip_noise_step_deg"]) if "tip_noise_step_deg" in motion else self.cell
        self.noise = np.concatenate([-reach[:0:-1], reach]) * self.noise_step
        self.chances = np.array([*half[:0:-1], *half])
        self.chances /= self.chances.sum()
        self.share = motion.get("straight_curvature_share")
        self.per_mm, self.rotation, self.discount = goal["insertion_per_mm"], goal["rotation"], goal["discount"]
        self.straight_per_mm = goal.get("straight_per_mm", self.per_mm)
        self.prices = np.array([0.0, 0.0, goal["collision"], goal["exit"]])

    def curvature_at(self, p: np.ndarray) -> np.ndarray:
        """Return the curvature of the needle, in 1/mm, at each point."""
        curvature = np.full(len(p), self.curvature)
        for from_mm, value in self.layers:
            curvature[p[:, 0] >= from_mm] = value
        for shape, value in self.tissues:
            curvature[shape.holds(p)] = value
        return curvature

    def arc(self, p: np.ndarray, heading: np.ndarray, side: np.ndarray, length: np.ndarray):
        """Insert by `length`; return the event, the end and the heading there. `side`: bevel times curvature share."""
        if not self.layers and not self.tissues:
            return self._piece(p, heading, side * self.curvature, length)
        event, piece = np.full(len(p), NONE), length / PIECES
        for _ in range(PIECES):
            middle = forward(p, heading, side * self.curvature_at(p), piece / 2)
            happened, end, turned = self._piece(p, heading, side * self.curvature_at(middle), piece)
            event = np.where(event == NONE, happened, event)
            p, heading = end, turned
        return event, p, heading

    def _piece(self, p: np.ndarray, heading: np.ndarray, curvature: np.ndarray, length: np.ndarray):
        first = np.stack([
            np.full(len(p), np.inf),
            self._first(p, heading, curvature, length, circles=self.target),
            self._first(p, heading, curvature, length, segments=self.segments, circles=self.circles),
            self._leaves(p, heading, curvature, length),
        ])  # fmt: skip
        return first.argmin(axis=0), forward(p, heading, curvature, length), heading + curvature * length

    def _first(self, p, heading, curvature, length, segments=(), circles=()):
        """Return the length at which each arc first meets a segment or a circle, or infinity."""
        first = np.full(len(p), np.inf)
        reach = float(length.max())
        for at, (x, y, radius) in enumerate(circles):
            near = np.flatnonzero(np.hypot(p[:, 0] - x, p[:, 1] - y) <= radius + reach)
            if not len(near):
                continue
            k, u = curvature[near], tangent(heading[near])
            d = p[near] - circles[at, :2]
            dd = (d**2).sum(axis=1) - radius**2
            dv = d[:, 1] * u[:, 0] - d[:, 0] * u[:, 1]
            for s in roots(dd * k**2 + 4 * k * dv + 4, 4 * (d * u).sum(axis=1), dd, k):
                first[near] = np.minimum(first[near], np.where((s >= 0) & (s <= length[near]), s, np.inf))
        for a, b in segments:
            along = (b - a) / math.dist(a, b)
            n = np.array([-along[1], along[0]])
            t = (p - a) @ along
            near = np.flatnonzero((abs((p - a) @ n) <= reach) & (t >= -reach) & (t <= math.dist(a, b) + reach))
            if not len(near):
                continue
            q, k, limit = p[near], curvature[near], length[near]
            for s in line(q, heading[near], k, n, float(n @ a)):
                t = (forward(q, heading[near], k, np.where((s >= 0) & (s <= limit), s, 0.0)) - a) @ along
                meets = (s >= 0) & (s <= limit) & (t >= 0) & (t <= math.dist(a, b))
                first[near] = np.minimum(first[near], np.where(meets, s, np.inf))
        return first

    def _leaves(self, p, heading, curvature, length):
        """Return the length at which each arc leaves the workspace, or infinity; the edges belong to the workspace."""
        first = np.full(len(p), np.inf)
        for n, c in (((1, 0), self.width), ((-1, 0), 0.0), ((0, 1), self.height), ((0, -1), 0.0)):
            near = np.flatnonzero(p @ np.array(n, float) >= c - length.max())
            k, limit = curvature[near], length[near]
            for s in line(p[near], heading[near], k, np.array(n, float), c):
                inside = (s >= 0) & (s <= limit)
                outward = tangent(heading[near] + k * np.where(inside, s, 0.0)) @ np.array(n, float) > 0
                first[near] = np.minimum(first[near], np.where(inside & outward, s, np.inf))
        return first


class Policy:
    """A policy table and its scenario, read with h5py; decisions by one-step look-ahead from exact poses."""

    def __init__(self, path: Path) -> None:
        with h5py.File(path) as file:
            self.model = Model(file.attrs["scenario"])
            self.spacing = np.array(file.attrs["spacing_mm"])
            self.values = file["values"][()]
        np.nan_to_num(self.values, copy=False, posinf=1e30)

    def mean_value(self, p: np.ndarray, heading: np.ndarray, bevel: np.ndarray) -> np.ndarray:
        """Return the value expected after the noise, interpolated along the tangent, across it, and in the heading."""
        _, ny, headings, _ = self.values.shape
        side = (bevel > 0).astype(int)
        corners = list(self.corners(p, heading))
        flat, total = self.values.reshape(-1), np.zeros(len(p))
        for noise, chance in zip(self.model.noise, self.model.chances, strict=True):
            row = (heading + noise) / self.model.cell
            k = np.floor(row).astype(int)
            f = row - k
            for dk, wk in ((0, 1 - f), (1, f)):
                cell = (k + dk) % headings * 2 + side
                for ix, iy, weight in corners:
                    total += chance * wk * weight * flat[(ix * ny + iy) * (2 * headings) + cell]
        return total

    def corners(self, p: np.ndarray, heading: np.ndarray):
        """Yield indices along x and y, and weights, of two points on both grid lines that the tangent crosses next."""
        swap = np.abs(np.sin(heading)) > np.abs(np.cos(heading))
        at, direction = p / self.spacing, np.stack([np.cos(heading), np.sin(heading)], -1) / self.spacing
        count = np.broadcast_to(self.values.shape[:2], at.shape)
        at, direction, count = (np.where(swap[:, None], each[:, ::-1], each) for each in (at, direction, count))
        first = np.clip(np.floor(at[:, 0]).astype(int), 0, np.maximum(count[:, 0] - 2, 0))
        for line in (first, first + 1):
            to = np.clip(at[:, 1] + (line - at[:, 0]) * direction[:, 1] / direction[:, 0], 0, count[:, 1] - 1)
            low = np.minimum(np.floor(to).astype(int), np.maximum(count[:, 1] - 2, 0))
            for point in (low, low + 1):
                weight = (1 - np.abs(at[:, 0] - line)) * (1 - np.abs(to - point))
                yield np.where(swap, point, line), np.where(swap, line, point), weight

    def decide(self, p: np.ndarray, heading: np.ndarray, bevel: np.ndarray):
        """Return action, value, cost of the step, event, end, heading and bevel after the step, before the noise."""
        model = self.model
        length = model.cell / model.curvature_at(p) if model.step is None else np.full(len(p), model.step)
        choices = [(bevel, 1.0, model.per_mm, 0.0), (-bevel, 1.0, model.per_mm, model.rotation)]
        if model.share is not None:
            choices.append((bevel, model.share, model.straight_per_mm, 0.0))
        best = None
        for action, (side, share, per_mm, turn) in enumerate(choices):
            event, end, turned = model.arc(p, heading, side * share, length)
            cost = length * per_mm + turn + model.prices[event]
            value, goes_on = cost.copy(), np.flatnonzero(event == NONE)
            value[goes_on] += model.discount * self.mean_value(end[goes_on], turned[goes_on], side[goes_on])
            this = [np.full(len(p), action), value, cost, event, end, turned, side]
            if best is None:
                best = this
            else:
                better = value < best[1]
                best = [np.where(better[:, None] if new.ndim == 2 else better, new, old)
                        for new, old in zip(this, best, strict=True)]  # fmt: skip
        return best

    def execute(self, poses: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Execute the policy once from each pose [n, 4]; return the outcomes and the discounted costs."""
        p, heading, bevel = poses[:, :2].copy(), poses[:, 2].copy(), poses[:, 3].copy()
        outcome, spent, weight = np.full(len(poses), NONE), np.zeros(len(poses)), 1.0
        going = np.arange(len(poses))
        for _ in range(MOST_STEPS):
            _, _, cost, event, end, turned, side = self.decide(p[going], heading[going], bevel[going])
            spent[going] += weight * cost
            weight *= self.model.discount
            outcome[going] = event
            p[going], bevel[going] = end, side
            heading[going] = turned + rng.choice(self.model.noise, len(going), p=self.model.chances)
            going = going[event == NONE]
            if not len(going):
                break
        return outcome, spent


def tangent(heading: np.ndarray) -> np.ndarray:
    """Return unit vectors [n, 2]."""
    return np.column_stack([np.cos(heading), np.sin(heading)])


def forward(p: np.ndarray, heading: np.ndarray, curvature: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Return the ends of arcs: a chord of length s sinc(k s / 2) in the middle direction."""
    half = curvature * length / 2
    return p + (length * np.sinc(half / np.pi))[:, None] * tangent(heading + half)


def line(p, heading, curvature, n: np.ndarray, offset: float):
    """Return the two lengths at which arcs meet the line n . z = offset, NaN or infinite where they do not."""
    u = tangent(heading)
    c = offset - p @ n
    nv = n[1] * u[:, 0] - n[0] * u[:, 1]
    return roots(curvature * (2 * nv - c * curvature), 2 * u @ n, -c, curvature)


def roots(a: np.ndarray, b: np.ndarray, c: np.ndarray, curvature: np.ndarray):
    """Return the lengths 2 atan(k w) / k of both roots w of a w^2 + b w + c = 0."""
    with np.errstate(all="ignore"):
        q = -(b + np.copysign(np.sqrt(b * b - 4 * a * c), b)) / 2
        for w in (q / a, c / q):
            yield np.where(curvature == 0, 2 * w, 2 * np.arctan(curvature * w) / curvature)
