"""Catalogue of further effects of the axial force, which the default library leaves out.

The motions of a usual recording hardly separate these effects from those of the default library: see the table in
docs/reference/diagnosis.md. `effects_of(channel, further=True)` includes them.
"""

from __future__ import annotations

import numpy as np

import needleplan.models.effects._contact as contact
from needleplan.models.effects._base import SIZE, Effect, Enters, Family
from needleplan.models.effects._catalogue import other_breaths, respiration_grid
from needleplan.models.effects._described import TermEffect, WrapEffect
from needleplan.models.effects._drive import LooseDrive, StickingDrive
from needleplan.models.effects._tissue import BreathingTissue

__all__ = ["FURTHER_FORCE_EFFECTS"]

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
        term=contact.GuideFriction,
        further=True,
    ),
    TermEffect(
        "friction_by_direction", "friction that differs in retraction", Family.FRICTION, Enters.SHAFT,
        "F += size F_shaft min(z, 0)", "Retraction meets another friction than insertion.",
        _OKAMURA + ", friction with a constant for each direction",
        term=contact.FrictionByDirection,
        further=True,
    ),
    TermEffect(
        "entry_spring", "spring at the entry", Family.TISSUE, Enters.TISSUE,
        "F += size min(L, depth)", "The dented skin, or a sleeve, pushes the needle back, whichever way it moves.",
        _OKAMURA + ", stiffness before the puncture; the end at a depth is ours",
        # A spring that is loaded all the way is a force in proportion to the depth.
        lambda reach: {"depth_mm": np.geomspace(3.0, max(reach.depth_mm[1] / 2, 6.0), 4)},
        term=contact.EntrySpring,
        further=True,
    ),
    TermEffect(
        "track_ageing", "track that smooths with each insertion", Family.TISSUE, Enters.SHAFT,
        "F -= size F_shaft/L int_0^L (1 - exp(-(n(x) - 1)/insertions)) dx, n(x) passes of the tip inwards",
        "The friction falls with the number of insertions along the same track.",
        "ours; friction that falls from cycle to cycle: needle steering thesis, 3.4.2",
        lambda reach: {"insertions": (0.3, 1.0, 3.0)},  # noqa: ARG005
        term=contact.TrackAgeing,
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
