"""Catalogue of further effects of the axial force, which the default library leaves out.

The motions of a usual recording hardly separate these effects from those of the default library: see the table in
docs/reference/diagnosis.md. `effects_of(channel, further=True)` includes them.

Further effects of guide, track and entry on the axial force. The bristle z of the shaft directs all friction.

| effect | physics |
|---|---|
| guide friction | Coulomb friction in the guide, before the tissue: it does not depend on the depth |
| friction by direction | tissue clings to the shaft in insertion and retraction with different strength |
| entry spring | the surface is a spring, loaded up to some depth; it pushes back whichever way the needle moves |
| ageing of the track | each earlier insertion along a place of the track smooths it |
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from needleplan.models._parameter import constant, parameter
from needleplan.models.effects._base import SIZE, Effect, Enters, Family, Memoryless
from needleplan.models.effects._catalogue import other_breaths, respiration_grid
from needleplan.models.effects._described import TermEffect, WrapEffect
from needleplan.models.effects._drive import LooseDrive, StickingDrive
from needleplan.models.effects._shaft import PathTerm
from needleplan.models.effects._tissue import BreathingTissue
from needleplan.signals import Array, Motion

__all__ = ["FURTHER_FORCE_EFFECTS", "EntrySpring", "FrictionByDirection", "GuideFriction", "TrackAgeing"]


# Length of a cell of the track, mm, and number of cells: `TrackAgeing` ignores depths beyond 150 mm.
_CELL_MM = 2.0
_CELLS = 75


@dataclass(frozen=True, kw_only=True)
class GuideFriction(PathTerm):
    """Friction of a guide, a seal or a bearing before the tissue.

    The normal force in the guide is constant, so the friction is `size` at every depth, and also outside of the tissue.
    """

    size: float = parameter("N", 0, 20, "friction in the guide", typical=0.05)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the bristle z, shape (...): the sign of the movement, after some presliding."""
        return np.asarray(state[0] * np.ones_like(np.asarray(motion.depth_mm, float)))


@dataclass(frozen=True, kw_only=True)
class FrictionByDirection(PathTerm):
    """Friction of the shaft that is different in retraction.

    The amplitude is a share of the friction of the base model, which holds for insertion.
    """

    size: float = parameter("", -1, 5, "change of the friction in retraction, as a share", typical=0.1)
    friction: float = constant("N/mm", 0, 10, "friction per inserted length of the model", default=1.0)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the friction of the shaft (N) where the bristle points outwards, else 0."""
        return np.asarray(self.friction * np.maximum(motion.depth_mm, 0.0) * np.minimum(state[0], 0.0))


@dataclass(frozen=True, kw_only=True)
class EntrySpring(Memoryless):
    """A spring at the entry, such as a dented skin or a sleeve, that is loaded up to a depth."""

    size: float = parameter("N/mm", 0, 1, "stiffness of the spring", typical=1e-3)
    depth_mm: float = parameter("mm", 0.5, 500, "depth up to which the spring is loaded", typical=1.0)

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the travel of the spring (mm), in both directions of the movement."""
        return np.asarray(np.clip(np.asarray(motion.depth_mm, float), 0.0, self.depth_mm))


@dataclass(frozen=True, kw_only=True)
class TrackAgeing(PathTerm):
    """Friction that falls with the number of insertions along the same track.

    The internal state also contains how often the tip has passed every cell of the track inwards. The last of n passes
    is the present insertion, so n - 1 insertions were earlier.
    """

    order: ClassVar[int] = 2 + _CELLS
    size: float = parameter("", 0, 1, "share of the friction that many insertions take away", typical=0.2)
    insertions: float = parameter("", 0.1, 50, "number of earlier insertions over which the friction falls")
    friction: float = constant("N/mm", 0, 10, "friction per inserted length of the model", default=1.0)

    def initial(self, motion: Motion) -> Array:
        """Return the state of the path, with the cells behind the tip passed once, shape (2 + cells,)."""
        return np.concatenate([super().initial(motion), _inside(np.ravel(motion.depth_mm)[:1])[:, 0]])

    def rate(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change, shape (2 + cells, ...); the passes grow in the cell of the tip."""
        depth, inwards = np.asarray(motion.depth_mm, float), np.maximum(motion.velocity_mm_s, 0.0)
        edges = (np.arange(_CELLS) * _CELL_MM).reshape((-1,) + (1,) * depth.ndim)
        here = (depth >= edges) & (depth < edges + _CELL_MM)
        return np.concatenate([super().rate(state[:2], motion), here * inwards / _CELL_MM])

    def states(self, motion: Motion, start: Array) -> Array:
        """Return the internal state along a motion, shape (2 + cells, samples)."""
        passed = _passes(np.asarray(motion.depth_mm, float).tobytes())
        states = np.empty((self.order, len(motion)))
        states[:2] = super().states(motion, start[:2])
        states[2:] = start[2:, None]
        states[2:, 1:] += passed
        return states

    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:  # noqa: ARG002
        """Return the friction (N) of the shaft, weighted with the ageing of each cell, with negative sign."""
        aged = -np.expm1(-np.maximum(state[2:] - 1, 0.0) / self.insertions)
        return np.asarray(
            -self.friction * _CELL_MM * (aged * _inside(np.asarray(motion.depth_mm))).sum(axis=0) * state[0]
        )


def _inside(depth_mm: Array) -> Array:
    """Return the share of every cell that the shaft fills, shape (cells, ...)."""
    edges = (np.arange(_CELLS) * _CELL_MM).reshape((-1,) + (1,) * np.ndim(depth_mm))
    return np.asarray(np.clip((depth_mm - edges) / _CELL_MM, 0.0, 1.0))


@lru_cache(maxsize=8)
def _passes(depth_mm: bytes) -> Array:
    """Return how often the tip has passed every cell inwards after each step, shape (cells, steps), read-only.

    `depth_mm` is the byte string of the depths, so that the result can be cached.
    """
    passed = np.cumsum(np.maximum(np.diff(_inside(np.frombuffer(depth_mm)), axis=1), 0.0), axis=1)
    passed.flags.writeable = False
    return passed


_OKAMURA = "Okamura, Simone and O'Leary, IEEE Trans. Biomed. Eng. 51 (2004) 1707"

FURTHER_FORCE_EFFECTS: tuple[Effect, ...] = (
    WrapEffect(
        "backlash", "play of the drive", Family.DRIVE, Enters.SHAFT,
        "L - p, p' = v inside of -size < p < 0, else 0",
        "After a reversal the motor crosses a gap before the needle moves.",
        "Nordin and Gutman, Automatica 38 (2002) 1633",
        lambda reach: {SIZE: np.geomspace(0.03, 3.0, 10)},  # noqa: ARG005
        wrapper=LooseDrive,
        further=True,
    ),
    WrapEffect(
        "drive_stick", "drive that sticks after a rest", Family.DRIVE, Enters.SHAFT,
        "L - p, p = s exp(-s/(e size)) sign(v), s the travel since the last rest",
        "After a rest or a reversal the needle falls behind the motor, and catches up.",
        "Armstrong, Dupont and Canudas de Wit, Automatica 30 (1994) 1083; the shape is ours",
        lambda reach: {SIZE: np.geomspace(0.03, 1.0, 6)},  # noqa: ARG005
        wrapper=StickingDrive,
        further=True,
    ),
    TermEffect(
        "guide_friction", "friction of the guide", Family.FRICTION, Enters.SHAFT,
        "F += size z", "The needle rubs in its guide, before the tissue, the same at every depth.",
        "ours; Coulomb friction with a constant normal force",
        term=GuideFriction,
        further=True,
    ),
    TermEffect(
        "friction_by_direction", "friction that differs in retraction", Family.FRICTION, Enters.SHAFT,
        "F += size F_shaft min(z, 0)", "Retraction meets another friction than insertion.",
        _OKAMURA + ", friction with a constant for each direction",
        term=FrictionByDirection,
        further=True,
    ),
    TermEffect(
        "entry_spring", "spring at the entry", Family.TISSUE, Enters.TISSUE,
        "F += size min(L, depth)", "The dented skin, or a sleeve, pushes the needle back, whichever way it moves.",
        _OKAMURA + ", stiffness before the puncture; the end at a depth is ours",
        # A spring that is loaded all the way is a force in proportion to the depth.
        lambda reach: {"depth_mm": np.geomspace(3.0, max(reach.depth_mm[1] / 2, 6.0), 4)},
        term=EntrySpring,
        further=True,
    ),
    TermEffect(
        "track_ageing", "track that smooths with each insertion", Family.TISSUE, Enters.SHAFT,
        "F -= size F_shaft/L int_0^L (1 - exp(-(n(x) - 1)/insertions)) dx, n(x) passes of the tip inwards",
        "The friction falls with the number of insertions along the same track.",
        "ours; friction that falls from cycle to cycle: needle steering thesis, 3.4.2",
        lambda reach: {"insertions": (0.3, 1.0, 3.0)},  # noqa: ARG005
        term=TrackAgeing,
        further=True,
    ),
    WrapEffect(
        "respiration_by_trial", "breathing with a phase of its own in each trial", Family.TISSUE, Enters.TISSUE,
        "as respiration, with another phase in each trial",
        "The tissue moves with the breath, and the clock of a trial does not begin with a breath.",
        "Lujan et al., Med. Phys. 26 (1999) 715; the phase by trial is ours",
        respiration_grid,
        other_breaths,
        wrapper=BreathingTissue,
        further=True,
        by_trial=("phase_rad",),
    ),
)  # fmt: skip
"""The further effects of the axial force, in the order of display."""
