"""Effects that a model may lack, as physics: what they add, on their own, to any model of their channel.

| here | what |
|---|---|
| `Effect` | an effect that can be looked for and added; what a plug-in is |
| `Term`, `WithTerm` | a force that is added, with a memory of its own |
| `Memoryless` | a term without one |
| `FORCE_EFFECTS`, `TIP_EFFECTS` | the effects of the axial force, and of the path of the tip |
| `known_effects`, `effect_named` | all of them, plug-ins too |
| `with_effect`, `AugmentedModel` | a model with effects, for model files, planner, twin and estimators |
"""

from needleplan.models.effects._augmented import AddedEffect, AugmentedModel, with_effect, without_effect
from needleplan.models.effects._base import SIZE, Effect, Enters, Family, Memoryless, Reach, Term, WithTerm
from needleplan.models.effects._catalogue import FORCE_EFFECTS
from needleplan.models.effects._described import TermEffect, WrapEffect, presliding_of
from needleplan.models.effects._tip_catalogue import (
    TIP_EFFECTS,
    effect_named,
    effects_of,
    known_effects,
    register_file,
)
from needleplan.models.effects._tissue import BreathingTissue, GivingTissue, SlowTurning

__all__ = [
    "FORCE_EFFECTS",
    "SIZE",
    "TIP_EFFECTS",
    "AddedEffect",
    "AugmentedModel",
    "BreathingTissue",
    "Effect",
    "Enters",
    "Family",
    "GivingTissue",
    "Memoryless",
    "Reach",
    "SlowTurning",
    "Term",
    "TermEffect",
    "WithTerm",
    "WrapEffect",
    "effect_named",
    "effects_of",
    "known_effects",
    "presliding_of",
    "register_file",
    "with_effect",
    "without_effect",
]
