"""Plan a scene by the kinodynamic RRT of OMPL, in a process of its own.

python benches/python/rrt_ompl.py < SCENE.json          # {"scene": {...}, "seed": 1, "limit": 1000000}

Prints a JSON object: whether the scene was solved, the controls as pairs of bevel and length in mm, the processor time
and the number of propagations. A process of its own is needed because OMPL accepts one seed per process.

The state is the pose. The control is the bevel, constant for 1 to 20 mm, in steps of 1 mm. A step is an arc and
is tested exactly. The tree keeps the state after every step.
"""

import json
import math
import os
import sys
from time import process_time
from typing import Any

import numpy as np
import rrt_arcs
from rrt_scenes import GOAL_TOLERANCE_MM, RADIUS_MM, SIDE_MM, Scene

STEP_MM = 1.0
LONGEST_STEPS = 20
GOAL_BIAS = 0.05
# Weight of a heading difference in the distance of two states (mm per rad).
HEADING_WEIGHT_MM = 20.0
MISSING = "OMPL is missing: install it with `python -m pip install ompl` (it is used by this benchmark only)"


def main() -> int:
    """Read the task from stdin, plan, and print the result."""
    task = json.load(sys.stdin)
    try:
        import ompl  # noqa: F401
    except ImportError:
        print(MISSING, file=sys.stderr)
        return 2
    print(json.dumps(planned(Scene.from_json(task["scene"]), task["seed"], task["limit"])))
    return 0


def planned(scene: Scene, seed: int, limit: int) -> dict[str, Any]:
    """Return the result of one run of RRT; `limit` is the largest number of propagations."""
    from ompl import base, control, util

    util.setLogLevel(util.LogLevel.LOG_ERROR)
    util.RNG.setSeed(seed)
    began = process_time()
    model = _Model(rrt_arcs.Space(scene))
    states = base.SE2StateSpace()
    states.setBounds(_bounds(base, 2, 0.0, SIDE_MM))
    states.setSubspaceWeight(1, HEADING_WEIGHT_MM)
    controls = control.RealVectorControlSpace(states, 1)
    controls.setBounds(_bounds(base, 1, -1.0, 1.0))
    information = control.SpaceInformation(states, controls)
    information.setStatePropagator(model.propagate)
    information.setStateValidityChecker(lambda state: state.getX() >= 0)
    information.setPropagationStepSize(STEP_MM)
    information.setMinMaxControlDuration(1, LONGEST_STEPS)
    setup = control.SimpleSetup(information)
    start = states.allocState()
    start.setXY(scene.start[0], scene.start[1])
    start.setYaw(scene.start[2])
    setup.setStartState(start)
    setup.setGoal(_goal(base, information, scene.target, seed))
    rrt = control.RRT(information)
    rrt.setIntermediateStates(True)
    rrt.setGoalBias(GOAL_BIAS)
    setup.setPlanner(rrt)
    prepared = process_time() - began
    setup.solve(base.PlannerTerminationCondition(lambda: model.propagations >= limit))
    solved = setup.haveExactSolutionPath()
    seconds = process_time() - began - prepared
    path = _controls(setup.getSolutionPath()) if solved else []
    return {
        "solved": solved,
        "path": path,
        "preparation_s": prepared,
        "search_s": seconds,
        "propagations": model.propagations,
    }


class _Model:
    """The bicycle model of the tip. A step that fails ends at x = -1, which the validity check refuses."""

    def __init__(self, space: rrt_arcs.Space) -> None:
        self.near = _edges_near(space)
        self.propagations = 0

    def propagate(self, state: Any, control: Any, duration: float, result: Any) -> None:
        self.propagations += 1
        signed = RADIUS_MM if control[0] > 0 else -RADIUS_MM
        x, y, heading = state.getX(), state.getY(), state.getYaw()
        turned = heading + duration / signed
        center = x - signed * math.sin(heading), y + signed * math.cos(heading)
        end = center[0] + signed * math.sin(turned), center[1] - signed * math.cos(turned)
        edges = self.near[round(x)][round(y)]
        if edges and _fails((x, y), end, center, edges):
            result.setX(-1.0)
            return
        result.setXY(*end)
        result.setYaw((turned + math.pi) % (2 * math.pi) - math.pi)


def _edges_near(space: rrt_arcs.Space) -> list[list[list[tuple[float, ...]]]]:
    """Return for every grid point (spacing 1 mm) the edges that a step from its cell may meet, the rim among them."""
    edges = np.concatenate([space.scene.edges, rrt_arcs.RIM])
    tail, way = edges[:, :2], edges[:, 2:] - edges[:, :2]
    size = (way**2).sum(axis=1)
    axis = np.arange(space.clearance.shape[0])
    lines = []
    for x in axis:
        points = np.column_stack([np.full(len(axis), x), axis])
        t = np.clip(((points[:, None] - tail) * way).sum(axis=2) / size, 0, 1)
        apart = np.hypot(*np.moveaxis(points[:, None] - tail - t[..., None] * way, 2, 0))
        near = apart <= STEP_MM + rrt_arcs.CELL_REACH_MM + 1e-6
        lines.append([[(*tail[i], *way[i], size[i]) for i in np.flatnonzero(row)] for row in near])
    return lines


def _fails(
    start: tuple[float, float],
    end: tuple[float, float],
    center: tuple[float, float],
    edges: list[tuple[float, ...]],
) -> bool:
    """Whether a short arc meets an edge, other than at its start, or ends outside of the workspace."""
    if not (0 <= end[0] <= SIDE_MM and 0 <= end[1] <= SIDE_MM):
        return True
    chord = end[0] - start[0], end[1] - start[1]
    reach = chord[0] ** 2 + chord[1] ** 2
    for x, y, dx, dy, a in edges:
        fx, fy = x - center[0], y - center[1]
        b = fx * dx + fy * dy
        root = b * b - a * (fx * fx + fy * fy - RADIUS_MM**2)
        if root < 0:
            continue
        for t in ((-b - math.sqrt(root)) / a, (-b + math.sqrt(root)) / a):
            if 0 <= t <= 1:
                # The place is on the circle; it is on the short arc if its projection is on the chord, and near it.
                px, py = x + t * dx - start[0], y + t * dy - start[1]
                if 1e-7 < px * chord[0] + py * chord[1] <= reach and px * px + py * py <= 2 * reach:
                    return True
    return False


def _goal(base: Any, information: Any, target: tuple[float, float], seed: int) -> Any:
    random = np.random.default_rng(seed)

    class Goal(base.GoalSampleableRegion):  # type: ignore[misc]
        """The disc of the target with any heading."""

        def distanceGoal(self, state: Any) -> float:  # noqa: N802
            return math.hypot(state.getX() - target[0], state.getY() - target[1])

        def sampleGoal(self, state: Any) -> None:  # noqa: N802
            state.setXY(*target)
            state.setYaw(random.uniform(-math.pi, math.pi))

        def maxSampleCount(self) -> int:  # noqa: N802
            return 1_000_000_000

        def couldSample(self) -> bool:  # noqa: N802
            return True

    goal = Goal(information)
    goal.setThreshold(GOAL_TOLERANCE_MM)
    return goal


def _bounds(base: Any, dimensions: int, low: float, high: float) -> Any:
    bounds = base.RealVectorBounds(dimensions)
    bounds.setLow(low)
    bounds.setHigh(high)
    return bounds


def _controls(path: Any) -> list[tuple[int, float]]:
    """Return the arcs of a solution as bevel and length, neighbours of one bevel merged."""
    arcs: list[tuple[int, float]] = []
    for index in range(path.getControlCount()):
        bevel = 1 if path.getControl(index)[0] > 0 else -1
        length = path.getControlDuration(index)
        if arcs and arcs[-1][0] == bevel:
            arcs[-1] = (bevel, arcs[-1][1] + length)
        else:
            arcs.append((bevel, length))
    return arcs


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # skips the check of the bindings for leaks, which prints to stderr
