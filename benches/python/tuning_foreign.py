"""Data sets for tuning with a foreign base: the scenes of tests/blind, but friction that reverses by another law.

The engine of the diagnosis assumes Dahl's law. Here the friction of a shaft element and of the tip follows, by seed,
one of four laws, at 50 or 100 Hz. u is the share of the friction that acts in the direction of the slip, p the slip,
and L the presliding length. Data sets of even numbers have the first and third law, the others the second and fourth.

| law | |
|---|---|
| Maxwell slip | the mean of five elastic elements that slip at L times 0.25, 0.5, 1, 2 and 4 |
| elasto-plastic | elastic up to the share b, then 1 - u decays over (1 - b) L (Dupont et al., 2002) |
| soft | du/dp = (1 - u)^2 / L: a long tail |
| abrupt | du/dp = (1 - u)^(1/2) / L: full friction after a travel of at most 2.8 L |

The tip reverses over another length than the shaft. The nominal friction is three times that of tests/blind, so that
the errors of the law stand out from the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from unittest.mock import patch

import numpy as np

from needleplan.models import ShaftAndTip
from tests.blind import base, force
from tests.blind.campaign import HETEROGENEITY, LARGEST, LARGEST_OF, NAMEABLE
from tests.blind.contact import EDGES_MM, ELEMENTS, WIDTH_MM, Compliance, Contact
from tests.blind.force import ForceSpec, Wanted
from tests.blind.motions import RICH, RICH_HELD_OUT, STEP_S, Array
from tests.blind.recording import DataSet
from tests.blind.truth import Truth

FRICTION_N_MM, PRESLIDING_MM = 0.035, 0.12
LAWS = ("maxwell slip", "elasto-plastic", "soft", "abrupt")
NOMINAL = ShaftAndTip(
    friction=FRICTION_N_MM, cutting=base.CUTTING_N, onset_mm=base.ONSET_MM, presliding_mm=PRESLIDING_MM
)
FIRST_SEED = 30_000_000
_SLIP_LENGTHS = np.array([0.25, 0.5, 1.0, 2.0, 4.0])[:, None, None]
_SMALLEST = 0.3  # size of a single effect, noise RMS
_NEWTON_STEPS, _SLOPE_MM = 6, 1e-6

Advance = Callable[[Array, Array], Array]
"""Function of u and of the slip over the presliding length; returns the new u."""


@dataclass(frozen=True)
class Scenery:
    """What a seed decides: law, share of the elastic travel, length of the tip over that of the shaft, rate."""

    law: str
    break_away: float
    tip: float
    every: int

    @classmethod
    def drawn(cls, seed: int) -> Scenery:
        """Return the scenery of a seed."""
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(9,)))
        return cls(LAWS[seed % 4], rng.uniform(0.3, 0.9), float(np.exp(rng.uniform(-0.7, 0.7))), 1 + seed // 4 % 2)

    def advance(self, u: Array, p: Array) -> Array:
        """Return u after a slip p, in units of the presliding length."""
        if self.law == "maxwell slip":
            return np.minimum(u + p / _SLIP_LENGTHS, 1.0)
        if self.law == "elasto-plastic":
            b = self.break_away
            elastic = np.clip(b - u, 0.0, p)
            return 1 - (1 - u - elastic) * np.exp(-(p - elastic) / (1 - b))
        if self.law == "soft":
            return 1 - (1 - u) / (1 + (1 - u) * p)
        if self.law == "dahl":  # drawn by tuning_base_laws only
            return 1 - (1 - u) * np.exp(-p)
        return 1 - np.maximum(np.sqrt(np.maximum(1 - u, 0.0)) - p / 2, 0.0) ** 2

    def touch(self, tip_mm: Array, compliance: Compliance) -> Contact:
        """Do what `tests.blind.contact.touch` does, with this law."""
        steps, trials = tip_mm.shape
        covered = np.clip(tip_mm[..., None] - EDGES_MM, 0.0, WIDTH_MM)
        kept = np.ones((steps, trials, ELEMENTS + 1))
        kept[1:, :, :-1] = np.minimum(1.0, covered[:-1] / np.maximum(covered[1:], 1e-12))
        kept[1:, :, :-1][covered[1:] == 0.0] = 0.0
        moved = np.diff(tip_mm, axis=0)[..., None]
        length = compliance.bristle_mm.copy()
        length[:, -1] *= self.tip
        give = compliance.give_mm
        alpha = 1.0 + compliance.lag_s / STEP_S
        state = np.zeros((5 if self.law == "maxwell slip" else 1, trials, ELEMENTS + 1))
        state[..., -1] = -1.0
        node = np.zeros((trials, ELEMENTS + 1))
        shares, slips = np.zeros_like(kept), np.zeros_like(kept)
        shares[0] = state.mean(axis=0)
        for k in range(1, steps):
            state = state * kept[k]
            if not give.any():
                slip = np.broadcast_to(np.abs(moved[k - 1]), node.shape)
                sign = np.sign(moved[k - 1]) + (moved[k - 1] == 0)
            else:
                drive = node + alpha * moved[k - 1]
                sign = np.where(give * state.mean(axis=0) < drive, 1.0, -1.0)
                slip = np.zeros_like(node)
                for _ in range(_NEWTON_STEPS):  # increasing and concave: steps from below do not overshoot
                    here = self.advance(sign * state, slip / length).mean(axis=0)
                    there = self.advance(sign * state, (slip + _SLOPE_MM) / length).mean(axis=0)
                    slope = alpha + give * (there - here) / _SLOPE_MM
                    slip = np.maximum(slip + (sign * drive - alpha * slip - give * here) / slope, 0.0)
            state = sign * self.advance(sign * state, slip / length)
            node = node + moved[k - 1] - sign * slip
            shares[k], slips[k] = state.mean(axis=0), sign * slip
        return Contact(covered, shares[..., :-1], slips[..., :-1], shares[..., -1])


@contextmanager
def _installed(scenery: Scenery) -> Iterator[None]:
    """Let tests/blind generate with this law and these nominal numbers."""
    keep = force.NOISE_KEEP ** (scenery.every / 2)
    plain = base.specimen

    def specimen(*given: object) -> base.Specimen:
        found = plain(*given)  # type: ignore[arg-type]
        compliance = found.compliance
        return replace(
            found, friction_n_mm=found.friction_n_mm * FRICTION_N_MM / base.FRICTION_N_MM,
            compliance=replace(compliance, bristle_mm=compliance.bristle_mm * PRESLIDING_MM / base.PRESLIDING_MM,
                               give_mm=0.0 * compliance.give_mm),
        )  # fmt: skip

    force._known.clear()
    with (
        patch.object(force, "touch", scenery.touch), patch.object(force, "specimen", specimen),
        patch.object(force, "EVERY", scenery.every), patch.object(force, "NOISE_KEEP", keep),
        patch.object(force, "COLOUR", replace(force.COLOUR, keep=keep)),
    ):  # fmt: skip
        yield
    force._known.clear()


def spec(stratum: str, index: int) -> ForceSpec:
    """Return the specification of a data set: `null`, or `single`, which goes through the effects of tests/blind."""
    seed = FIRST_SEED + 100_000 * (stratum != "null") + index
    wanted: tuple[Wanted, ...] = ()
    if stratum != "null":
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3,)))
        name = NAMEABLE[index // 2 % len(NAMEABLE)]
        ends = np.log([_SMALLEST, LARGEST_OF.get(name, LARGEST)])
        wanted = (Wanted(name, float(np.exp(rng.uniform(*ends)))),)
    return ForceSpec(seed, wanted, HETEROGENEITY[index // 5 % 3], RICH, RICH_HELD_OUT)


def generate(given: ForceSpec) -> tuple[DataSet, Truth]:
    """Return recordings and the truth about them."""
    with _installed(Scenery.drawn(given.seed)):
        return force.generate(given)


def rate_hz(given: ForceSpec) -> int:
    """Return the sampling rate of a data set."""
    return 100 // Scenery.drawn(given.seed).every
