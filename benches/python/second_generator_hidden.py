"""What a hidden effect is, and the force of a trial with a set of them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from second_generator_law import Insertion

Numbers = dict[str, float]
# the trial, its force or depth so far, the size, the numbers, the number of the trial -> force or depth
Law = Callable[[Insertion, np.ndarray, float, Numbers, int], np.ndarray]


def uniform(**ranges: tuple[float, float]) -> Callable[[np.random.Generator], Numbers]:
    """Draws each number uniformly in its range."""
    return lambda rng: {name: float(rng.uniform(low, high)) for name, (low, high) in ranges.items()}


NOTHING = uniform()  # for an effect without place, time or speed


@dataclass(frozen=True)
class Kind:
    """A hidden effect.

    Attributes
    ----------
    name, formula, unit : str
        Name; law in words and symbols; unit of the size.
    stage : str
        `motion`: `act` returns the depth in the tissue. `law`: an additional force. `sensor`: the measured force.
    act : callable(insertion, force, size, numbers, trial)
    draw : callable(rng) -> dict
        Places, times, speeds and shapes; the size is drawn apart.
    size, low, high : float
        Size to begin with, and its physical bounds.
    axis : str
        Variable on which the effect depends; `also`: further right answers.
    library : str
        `documented` or `none`.
    """

    name: str
    stage: str
    axis: str
    formula: str
    act: Law
    size: float
    low: float
    high: float
    unit: str
    draw: Callable[[np.random.Generator], Numbers] = NOTHING
    also: tuple[str, ...] = ()
    library: str = "documented"

    @property
    def linear(self) -> bool:
        """Whether the hidden force is in proportion to the size."""
        return self.stage != "motion" and self.name not in ("latency", "clock_skew", "dead_zone")


@dataclass(frozen=True)
class Hidden:
    """A kind with its drawn size and numbers."""

    kind: Kind
    size: float
    numbers: Numbers


def hidden_force(base: Insertion, hidden: list[Hidden], trial: int) -> np.ndarray:
    """Force at 5 kHz with the effects: those of the motion first, then those of the law, then those of the sensor."""
    insertion = base
    by_stage = {stage: [each for each in hidden if each.kind.stage == stage] for stage in ("motion", "law", "sensor")}
    for each in by_stage["motion"]:
        insertion = insertion.moved(each.kind.act(insertion, insertion.depth, each.size, each.numbers, trial))
    force = insertion.force
    for each in by_stage["law"]:
        force = force + each.kind.act(insertion, insertion.force, each.size, each.numbers, trial)
    for each in by_stage["sensor"]:
        force = each.kind.act(insertion, force, each.size, each.numbers, trial)
    return force
