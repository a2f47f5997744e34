"""Random scenarios for hypothesis."""

import math

from hypothesis import strategies as st

from needleplan.scenario import (
    Grid,
    Layer,
    Method,
    Needle,
    Objective,
    Obstacle,
    Priority,
    Scenario,
    Solver,
    Target,
    TipMotion,
    Tissue,
    Transition,
    Workspace,
)

_LENGTHS = st.floats(5, 500)
_TEXTS = st.text(st.characters(codec="utf-8"), max_size=30)


@st.composite
def obstacles(draw: st.DrawFn, width: float, height: float) -> Obstacle:
    """A star-shaped polygon in the left half of the workspace; the target lies in the right half."""
    x, y = draw(st.floats(0.1, 0.25)) * width, draw(st.floats(0.1, 0.9)) * height
    corners = draw(st.integers(3, 9))
    radii = draw(st.lists(st.floats(0.02, 0.2), min_size=corners, max_size=corners))
    angles = [2 * math.pi * corner / corners for corner in range(corners)]
    return Obstacle(
        polygon_mm=[
            (x + r * width * math.cos(a), y + r * width * math.sin(a)) for r, a in zip(radii, angles, strict=True)
        ],
        name=draw(_TEXTS),
    )


@st.composite
def layers(draw: st.DrawFn, width: float) -> tuple[Layer, ...]:
    """Layers that begin within the width."""
    starts = sorted(draw(st.lists(st.floats(0, 1), max_size=3, unique=True)))
    return tuple(Layer(start, draw(_LENGTHS)) for start in sorted({start * width for start in starts}))


@st.composite
def scenarios(draw: st.DrawFn) -> Scenario:
    """Any valid scenario."""
    width, height = draw(_LENGTHS), draw(_LENGTHS)
    spacing = (width / draw(st.integers(4, 40)), height / draw(st.integers(4, 40)))
    tail = draw(st.lists(st.floats(0, 0.05), max_size=4))
    return Scenario(
        title=draw(_TEXTS),
        workspace=Workspace(width, height),
        obstacles=tuple(draw(st.lists(obstacles(width, height), max_size=3))),
        target=Target((draw(st.floats(0.6, 1)) * width, draw(st.floats(0, 1)) * height), math.hypot(*spacing)),
        needle=Needle(draw(_LENGTHS), draw(layers(width))),
        tissues=tuple(
            Tissue(each.polygon_mm, draw(_LENGTHS), each.name)
            for each in draw(st.lists(obstacles(width, height), max_size=2))
        ),
        motion=TipMotion(
            draw(st.integers(9, 100)),
            (1 - 2 * math.fsum(tail), *tail),
            draw(st.integers(1, 9)),
            draw(st.none() | st.floats(0.1, 5)),
            draw(st.none() | st.floats(0.01, 20)),
        ),
        grid=Grid(spacing, draw(st.sampled_from(Transition))),
        objective=Objective(
            insertion_per_mm=draw(st.floats(1e-3, 1e3)),
            rotation=draw(st.floats(0, 1e4)),
            collision=draw(st.floats(0, 1e6)),
            exit=draw(st.floats(0, 1e6)),
            discount=draw(st.floats(0.01, 1)),
            **draw(
                st.just({}) | st.fixed_dictionaries({"clearance_mm": _LENGTHS, "clearance_per_mm": st.floats(0, 1e3)})
            ),
        ),
        solver=Solver(
            method=draw(st.sampled_from(Method)),
            partitions=draw(st.none() | st.tuples(st.integers(1, 5), st.integers(1, 5))),
            priority=draw(st.sampled_from(Priority)),
            tolerance=draw(st.floats(1e-9, 10)),
            max_sweeps=draw(st.none() | st.integers(1, 10**9)),
            time_limit_s=draw(st.none() | st.floats(1e-3, 1e9)),
            threads=draw(st.none() | st.integers(1, 64)),
        ),
    )
