"""A slow, plain twin of the planner, first part: the scenario's numbers and what happens along one arc.

Tests are closed, and coordinates are computed in floating point, so every test has the same tolerance
`TOLERANCE_MM`: a point that lies on an edge in exact arithmetic counts as on it. An end point exactly halfway
between two grid points goes up (`nearest_index`); the definition does not say.

The radius of an arc is that of the place where it starts: of the last tissue that holds the point, else of the
last layer with from_mm <= x, else of the needle. Its length is that radius times alpha, or `step`.

Every step of a `Problem` has the same share of the curvature: 1 for ordinary steps. The straight steps of a scenario
are a `Problem` of their own (`Problem.straight`), with another share and another price of a millimetre.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Kinds = NDArray[np.int8]

TOLERANCE_MM = 1e-9
TOLERANCE_HEADINGS = 1e-9  # a turn this close to a whole number of headings is one
GOES_ON, EXIT, COLLISION, TARGET = 0, 1, 2, 3
FREE, OBSTACLE, GOAL = 0, 2, 3  # kinds of a grid point; the numbers match the events they cause
BEVELS = (-1, 1)


@dataclass(frozen=True)
class Problem:
    """The numbers of a scenario (lengths in mm)."""

    width: float
    height: float
    polygons: tuple[shapely.Polygon, ...]
    target: tuple[float, float]
    target_radius: float
    rho: float
    headings: int
    noise: dict[int, float]  # heading steps m -> probability
    samples: int
    dx: float
    dy: float
    interpolated: bool
    insertion: float
    rotation: float
    collision: float
    exit: float
    discount: float
    layers: tuple[tuple[float, float], ...] = ()  # from x, radius
    clearance: tuple[float, float] = (0.0, 0.0)  # distance from obstacles, price per mm of steps that begin within it
    tissues: tuple[tuple[shapely.Geometry, float, float], ...] = ()  # core, distance from it within the tissue, radius
    step: float | None = None  # length of every step; None: the radius times alpha
    noise_angle: float | None = None  # of one noise step, in rad; None: alpha
    share: float = 1.0  # of the curvature that a step has; 0 is a line
    straight: "Problem | None" = None  # the same with the share and the price of straight steps

    @property
    def nx(self) -> int:
        return math.ceil(self.width / self.dx - TOLERANCE_MM) + 1

    @property
    def ny(self) -> int:
        return math.ceil(self.height / self.dy - TOLERANCE_MM) + 1

    @property
    def alpha(self) -> float:
        return 2.0 * np.pi / self.headings

    @property
    def eta(self) -> float:
        return self.alpha if self.noise_angle is None else self.noise_angle


def problem_from(scenario: dict[str, Any]) -> Problem:
    """Read the dict that tomllib returns for a scenario file. A missing key is an error if the thesis needs it."""
    motion, grid, objective = scenario["motion"], scenario["grid"], scenario["objective"]
    taps = [float(p) for p in motion["tip_noise"]]
    noise = {0: taps[0]}
    for m, p in enumerate(taps[1:], start=1):
        noise[m] = noise[-m] = p
    if abs(sum(noise.values()) - 1.0) > 1e-9:
        raise ValueError(f"tip_noise must sum to one when doubled, got {sum(noise.values())}")
    noise_deg, share = motion.get("tip_noise_step_deg"), motion.get("straight_curvature_share")
    problem = Problem(
        width=float(scenario["workspace"]["width_mm"]),
        height=float(scenario["workspace"]["height_mm"]),
        polygons=tuple(shapely.Polygon(obstacle["polygon_mm"]) for obstacle in scenario.get("obstacle", [])),
        target=(float(scenario["target"]["center_mm"][0]), float(scenario["target"]["center_mm"][1])),
        target_radius=float(scenario["target"]["radius_mm"]),
        rho=float(scenario["needle"]["curvature_radius_mm"]),
        headings=int(motion["headings"]),
        noise=noise,
        samples=int(motion["arc_samples"]),
        dx=float(grid["spacing_mm"][0]),
        dy=float(grid["spacing_mm"][1]),
        interpolated={"nearest": False, "interpolated": True}[grid["transition"]],
        insertion=float(objective["insertion_per_mm"]),
        rotation=float(objective["rotation"]),
        collision=float(objective["collision"]),
        exit=float(objective["exit"]),
        discount=float(objective["discount"]),
        clearance=(objective.get("clearance_mm", 0.0), objective.get("clearance_per_mm", 0.0)),
        layers=tuple((each["from_mm"], each["curvature_radius_mm"]) for each in scenario["needle"].get("layer", [])),
        tissues=tuple((*core_of(each), each["curvature_radius_mm"]) for each in scenario.get("tissue", [])),
        step=motion.get("step_mm"),
        noise_angle=None if noise_deg is None else math.radians(noise_deg),
    )
    if share is None:
        return problem
    price = objective.get("straight_per_mm", problem.insertion)
    return replace(problem, straight=replace(problem, share=float(share), insertion=float(price)))


def core_of(shape: dict[str, Any]) -> tuple[shapely.Geometry, float]:
    """A polygon, a point or a segment, and how far the region reaches beyond it."""
    if "polygon_mm" in shape:
        return shapely.Polygon(shape["polygon_mm"], shape.get("holes_mm")), 0.0
    if "center_mm" in shape:
        return shapely.Point(shape["center_mm"]), float(shape["radius_mm"])
    return shapely.LineString(shape["ends_mm"]), float(shape["radius_mm"])


def radius_at(problem: Problem, x: Floats, y: Floats) -> Floats:
    """The radius of an arc that starts at (x, y)."""
    radius = np.full(x.shape, problem.rho)
    for from_mm, rho in problem.layers:
        radius = np.where(x >= from_mm - TOLERANCE_MM, rho, radius)
    for core, reach, rho in problem.tissues:
        radius = np.where(shapely.distance(core, shapely.points(x, y)) <= reach + TOLERANCE_MM, rho, radius)
    return radius


def length_at(problem: Problem, x: Floats, y: Floats) -> Floats:
    """The length of a step that starts at (x, y), straight or not."""
    return radius_at(problem, x, y) * problem.alpha if problem.step is None else np.full(x.shape, problem.step)


def turn_at(problem: Problem, x: Floats, y: Floats, length: Floats) -> Floats:
    """The angle by which an arc of this length turns the heading if it has the curvature of (x, y)."""
    return problem.share * length / radius_at(problem, x, y)


def price_at(problem: Problem, x: Floats, y: Floats) -> Floats:
    """The cost per mm of a step that starts at (x, y)."""
    distance, price = problem.clearance
    near = np.zeros(x.shape, bool)
    for polygon in problem.polygons:
        near |= shapely.distance(polygon, shapely.points(x, y)) <= distance + TOLERANCE_MM
    return problem.insertion + price * near


def arc_point(problem: Problem, x: Floats, y: Floats, theta: Floats, bevel: Ints, t: float) -> tuple[Floats, Floats]:
    """The point at the fraction t of the arc that starts at (x, y, theta)."""
    length = length_at(problem, x, y) * t
    x_end, y_end, _ = turned_by(turn_at(problem, x, y, length), length, x, y, theta, bevel)
    return x_end, y_end


def turned_by(
    angle: Floats, length: Floats, x: Floats, y: Floats, theta: Floats, bevel: Ints
) -> tuple[Floats, Floats, Floats]:
    """The pose after an arc of one radius that turns the heading by `angle`; a line if the angle is 0."""
    turned, bent = theta + bevel * angle, angle > 0.0
    rho = length / np.where(bent, angle, 1.0)
    return (
        x + np.where(bent, rho * bevel * (np.sin(turned) - np.sin(theta)), length * np.cos(theta)),
        y - np.where(bent, rho * bevel * (np.cos(turned) - np.cos(theta)), -length * np.sin(theta)),
        turned,
    )


def split(headings: float) -> dict[int, float]:
    """The two whole headings around a number of headings, with linear weights; one of them if the number is whole."""
    low = math.floor(headings + TOLERANCE_HEADINGS)
    above = headings - low
    return {low: 1.0} if abs(above) <= TOLERANCE_HEADINGS else {low: 1.0 - above, low + 1: above}


def heading_spread(problem: Problem) -> dict[int, float]:
    """By how many headings a step with bevel +1 turns, with probabilities; with bevel -1 by as many to the other side.

    The mean is the turn, and the variance is that of the noise, or the smallest possible one if that is larger.
    """
    if problem.step is not None and (problem.layers or problem.tissues):
        raise ValueError("step_mm with layers or tissues: the oracle has no mean curvature along a planned step")
    c = problem.share if problem.step is None else problem.share * problem.step / problem.rho / problem.alpha
    still, noisy = split(c), dict[int, float]()
    for m, p in problem.noise.items():
        for heading, weight in split(c + m * problem.eta / problem.alpha).items():
            noisy[heading] = noisy.get(heading, 0.0) + p * weight
    variance = sum(p * (m * problem.eta / problem.alpha) ** 2 for m, p in problem.noise.items())
    least, total = (sum(p * (heading - c) ** 2 for heading, p in each.items()) for each in (still, noisy))
    if variance < least:
        share = 0.0
    else:  # total - least = S + E - e of the page; it is 0 only without noise
        share = 1.0 if total - least <= TOLERANCE_HEADINGS else (variance - least) / (total - least)
    return {k: share * noisy.get(k, 0.0) + (1.0 - share) * still.get(k, 0.0) for k in {**still, **noisy}}


def limits_from(problem: Problem, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """The largest x and y that a step from (x, y) may reach: the border, or the start if it is a grid point beyond."""
    return np.maximum(x, problem.width), np.maximum(y, problem.height)


def point_event(problem: Problem, x: Floats, y: Floats, limits: tuple[Floats, Floats] | None = None) -> Kinds:
    """What a true point is: EXIT before COLLISION before TARGET, else GOES_ON. Every test is closed."""
    width, height = limits or (np.asarray(problem.width), np.asarray(problem.height))
    event = np.full(x.shape, GOES_ON, dtype=np.int8)
    distance = np.hypot(x - problem.target[0], y - problem.target[1])
    event[distance <= problem.target_radius + TOLERANCE_MM] = TARGET
    for polygon in problem.polygons:
        x0, y0, x1, y1 = polygon.buffer(1.0).bounds  # only points near the polygon need the expensive test
        near = np.flatnonzero((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1))
        points = shapely.points(x.ravel()[near], y.ravel()[near])
        shapely.prepare(polygon)
        event.ravel()[near[shapely.dwithin(polygon, points, TOLERANCE_MM)]] = COLLISION
    inside_x = (x >= -TOLERANCE_MM) & (x <= width + TOLERANCE_MM)
    inside_y = (y >= -TOLERANCE_MM) & (y <= height + TOLERANCE_MM)
    event[~(inside_x & inside_y)] = EXIT
    return event


def follow_arc(problem: Problem, x: Floats, y: Floats, theta: Floats, bevel: Ints) -> tuple[Kinds, Floats, Floats]:
    """The first event along the arc, and the arc's end point."""
    event = np.full(x.shape, GOES_ON, dtype=np.int8)
    for sample in range(1, problem.samples + 1):
        x_end, y_end = arc_point(problem, x, y, theta, bevel, sample / problem.samples)
        here = point_event(problem, x_end, y_end, limits_from(problem, x, y))
        event = np.where(event == GOES_ON, here, event)
    return event, x_end, y_end


def follow_pieces(
    problem: Problem, x: Floats, y: Floats, theta: Floats, bevel: Ints, ahead: float = 0.0
) -> tuple[Kinds, Floats, Floats, Floats]:
    """The first event along a step of the continuous needle, and the pose at its end.

    The step is as long as the place where it starts says; it consists of pieces of one length, as many as there are
    samples, and each has the radius of the place where it starts, or which lies so many pieces straight ahead of it.
    """
    event = np.full(x.shape, GOES_ON, dtype=np.int8)
    piece = length_at(problem, x, y) / problem.samples
    for _ in range(problem.samples):
        there = x + ahead * piece * np.cos(theta), y + ahead * piece * np.sin(theta)
        x, y, theta = turned_by(turn_at(problem, *there, piece), piece, x, y, theta, bevel)
        event = np.where(event == GOES_ON, point_event(problem, x, y), event)
    return event, x, y, theta


def nearest_index(coordinate: Floats, spacing: float) -> Ints:
    """Index of the nearest grid point, not clipped; an exact tie goes up."""
    return np.floor(coordinate / spacing + 0.5 + TOLERANCE_MM).astype(np.int64)


def bilinear_corners(problem: Problem, x: Floats, y: Floats) -> tuple[Ints, Floats]:
    """Flat grid index and weight of the four corners around each point; last axis is the corner."""
    i, j = np.floor(x / problem.dx).astype(np.int64), np.floor(y / problem.dy).astype(np.int64)
    u, v = x / problem.dx - i, y / problem.dy - j
    corners, weights = [], []
    for di, dj in ((0, 0), (1, 0), (0, 1), (1, 1)):
        inside = (i + di >= 0) & (i + di < problem.nx) & (j + dj >= 0) & (j + dj < problem.ny)
        corners.append(np.where(inside, (i + di) * problem.ny + j + dj, problem.nx * problem.ny))
        weights.append((u if di else 1.0 - u) * (v if dj else 1.0 - v))
    return np.stack(corners, axis=-1), np.stack(weights, axis=-1)


def stations_of(
    problem: Problem, place: tuple[Any, Any], theta: Any
) -> tuple[NDArray[np.bool_], Floats, Floats, Floats]:
    """Whether tangents are read where they cross rows, not columns; places along and across, and slopes, in cells."""
    x, y = place[0] / problem.dx, place[1] / problem.dy
    steep = np.abs(np.sin(theta)) > np.abs(np.cos(theta))
    with np.errstate(divide="ignore"):
        slope = np.where(steep, problem.dy / np.tan(theta) / problem.dx, np.tan(theta) * problem.dx / problem.dy)
    return steep, np.where(steep, y, x), np.where(steep, x, y), slope


def tangent_corners(problem: Problem, x: Floats, y: Floats, theta: Floats) -> tuple[Ints, Floats]:
    """Flat grid index and weight of two points on each of the two nearest lines that the tangents at poses cross."""
    steep, along, across, slope = stations_of(problem, (x, y), theta)
    lines, points = np.where(steep, problem.ny, problem.nx), np.where(steep, problem.nx, problem.ny)
    corners, weights = [], []
    for n in (0, 1):
        line = np.floor(along) + n
        place = np.clip(across + (line - along) * slope, 0.0, points - 1.0)
        for m in (0, 1):
            point = np.minimum(np.floor(place) + m, points - 1)  # one beyond the last has no weight
            i, j = np.where(steep, point, line).astype(np.int64), np.where(steep, line, point).astype(np.int64)
            inside = (line >= 0) & (line < lines)
            corners.append(np.where(inside, i * problem.ny + j, problem.nx * problem.ny))
            share = place - np.floor(place)
            weights.append((1.0 - np.abs(along - line)) * (share if m else 1.0 - share))
    return np.stack(corners, axis=-1), np.stack(weights, axis=-1)


def edge_distance(problem: Problem, x: Floats, y: Floats) -> Floats:
    """Distance to the nearest obstacle edge or the target circle: where it is tiny, rounding errors decide an event."""
    distance = np.abs(np.hypot(x - problem.target[0], y - problem.target[1]) - problem.target_radius)
    for polygon in problem.polygons:
        distance = np.minimum(distance, shapely.distance(polygon.exterior, shapely.points(x, y)))
    return distance
