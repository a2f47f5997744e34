from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from needleplan.models import simulate
from needleplan.models.force.sensitivity import NAMES, Row, Values, exponential_step, force, kutta_step, slope
from needleplan.signals import Motion, insertion_cycles
from needleplan_thesis.chapter2.forces import PUBLISHED_FORCES

factors = st.tuples(*[st.floats(0.4, 2.5)] * 8)


def values_of(number: int, by: tuple[float, ...]) -> tuple[float, Values]:
    chosen = PUBLISHED_FORCES[number].model
    values = tuple(getattr(chosen, name) * factor for name, factor in zip(NAMES, by[1:], strict=True))
    return chosen.beta * chosen.f1 / chosen.sigma0 * by[0], values  # type: ignore[return-value]


def differences(function: Callable[[float, Values], float], z: float, values: Values) -> list[float]:
    """Central differences, by z and by the parameters."""
    point = np.array([z, *values])
    result = []
    for index in range(point.size):
        step = np.zeros_like(point)
        step[index] = 1e-6 * abs(point[index])
        up, down = point + step, point - step
        rise = function(up[0], tuple(up[1:])) - function(down[0], tuple(down[1:]))  # type: ignore[arg-type]
        result.append(rise / (2 * step[index]))
    return result


FUNCTIONS: dict[str, Callable[[float, Values, float], Row]] = {
    "slope": slope,
    "force in": lambda z, values, depth: force(z, values, depth, 1.0),
    "force out": lambda z, values, depth: force(z, values, depth, -1.0),
    "exponential": lambda z, values, depth: exponential_step(z, values, depth, 0.02),
    "kutta": lambda z, values, depth: kutta_step(z, values, (depth, depth + 0.1, depth + 0.2), 0.02),
}


@settings(max_examples=15, deadline=None)
@given(by=factors, depth=st.floats(0.5, 90), number=st.integers(0, 4))
@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_are_those_of_differences(name: str, by: tuple[float, ...], depth: float, number: int) -> None:
    z, values = values_of(number, by)
    assume(values[3] + values[4] > 0.1 * values[3])
    found, by_z, by_values = FUNCTIONS[name](z, values, depth)
    slow = differences(lambda x, p: FUNCTIONS[name](x, p, depth)[0], z, values)
    scale = np.abs(np.array([z, *values]))
    size = max(abs(found), 1e-3)
    np.testing.assert_allclose(
        np.array([by_z, *by_values]) * scale, np.array(slow) * scale, atol=3e-8 * size, rtol=1e-5
    )


@pytest.mark.parametrize("number", range(5))
def test_steps_follow_the_simulation(number: int) -> None:
    chosen = PUBLISHED_FORCES[number]
    motion = insertion_cycles(80.0, chosen.velocity_mm_s)
    done = simulate(chosen.model, motion)
    values: Values = tuple(getattr(chosen.model, name) for name in NAMES)  # type: ignore[assignment]
    held, kutta = [0.0], [0.0]
    depth = motion.depth_mm.tolist()
    for before, after in pairwise(depth):
        middle = (before + after) / 2
        held.append(exponential_step(held[-1], values, middle, 0.005)[0])
        kutta.append(kutta_step(kutta[-1], values, (before, middle, after), 0.005)[0])
    np.testing.assert_allclose(kutta, done.states[0], atol=1e-6 * max(kutta))
    np.testing.assert_allclose(held, done.states[0], atol=1e-4 * max(held))
    instant: Motion = motion[700]
    found = force(done.states[0, 700], values, float(instant.depth_mm), float(instant.direction))[0]
    assert found == pytest.approx(done.output[700], abs=1e-14)
