"""What a diagnosis must know of the quantity that is measured; everything else is the same for all of them.

A channel is another instance of `Measurand`: how tissue that is not the same everywhere shows in it, where its motion
is not known well enough, and along which axes a gap without a name is looked for. `channels` lists them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from needleplan.diagnosis.verdict import Gates
from needleplan.models import Channel, Model
from needleplan.signals import Array, Motion

if TYPE_CHECKING:
    from needleplan.diagnosis.calibrate import Case

__all__ = ["Axis", "Basis", "Measurand"]


class Axis(StrEnum):
    """Along what a gap lies."""

    TIME = "time"
    DEPTH = "depth"
    SPEED = "speed"
    FORCE = "force"
    HOLD = "hold"
    PERIOD = "position_periodic"
    ANGLE = "angle"


@dataclass(frozen=True)
class Basis:
    """A smooth function without a name: its columns along every trial, raw, (samples, df) each, one set of sizes."""

    axis: Axis
    columns: tuple[Array, ...]
    beside_effects: bool = True
    """Whether it is a competitor beside effects too; else of a name for the gap of the base alone."""


@dataclass(frozen=True)
class Measurand:
    """A quantity that models predict and sensors measure."""

    channel: Channel
    usual_lag_s: float
    """Standard deviation of the lag that its sensor may have without anybody calling it an effect; 0 for no lag."""

    beliefs: Mapping[str, float]
    """Standard deviation of the coordinate of parameters about their value in the model; of others, a factor of two."""

    modes: Callable[[Model, Motion], Array]
    """What it gains for every mode of the tissue's variation at level 1, shape (samples, modes)."""

    moments: Callable[[Array, Motion], Array]
    """What an error of the moment of a sudden change would show, at one standard deviation: (samples, moments).

    Takes what is predicted, shape (samples,), and the motion.
    """

    bases: Callable[[Sequence[Case]], Mapping[str, Basis]]
    """Competitors without a name, by name."""

    independent: Callable[[Motion], int] = lambda motion: 0  # noqa: ARG005
    """How many samples of a trial say something of their own; 0 for all."""

    gates: Gates = Gates()
    """Thresholds."""

    held: tuple[str, ...] = ()
    """Parameters that are known closely, and in which the output is linear: calibrated by their sensitivities alone."""

    rounds: int = 4
    """How often base and effects are fitted in turn, at most: more where effects are far from linear."""

    usual_level: float = math.inf
    """Standard deviation of what tissues vary by: how far a gap may be laid to that; any level where it is infinite."""
