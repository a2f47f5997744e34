"""Effects: physical phenomena that can be added to a model that lacks them.

| name | meaning |
|---|---|
| `Effect` | abstract: an effect that the diagnosis can search for and add; the interface of plug-ins |
| `Term`, `WithTerm` | an additional force with its own internal state, and a model with such a force |
| `Memoryless` | a term without an internal state |
| `FORCE_EFFECTS`, `TIP_EFFECTS` | the shipped effects of the axial force, and of the path of the tip |
| `FURTHER_FORCE_EFFECTS` | effects of the axial force that the default library leaves out |
| `LAB_EFFECTS` | the effects of the lab twin, by the keys of a simulation file, beside the effects of models |
| `known_effects`, `effect_named` | all effects by name, including plug-ins |
| `with_effect`, `AugmentedModel` | a model with effects, for model files, planner, lab twin and estimators |
"""

from needleplan.models.effects._augmented import AddedEffect, AugmentedModel, with_effect
from needleplan.models.effects._base import (
    SIZE,
    Effect,
    Enters,
    Family,
    Memoryless,
    Reach,
    Term,
    WithTerm,
    effect_columns,
)
from needleplan.models.effects._catalogue import FORCE_EFFECTS
from needleplan.models.effects._described import TermEffect, WrapEffect, presliding_of
from needleplan.models.effects._further_catalogue import FURTHER_FORCE_EFFECTS
from needleplan.models.effects._lab_catalogue import LAB_EFFECTS, LabEffect, LabKey, lab_key
from needleplan.models.effects._laws import bent_needle, breathing, speed_factor, weight_curvature
from needleplan.models.effects._sensor import Bias, Drift, GainError
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
    "FURTHER_FORCE_EFFECTS",
    "LAB_EFFECTS",
    "SIZE",
    "TIP_EFFECTS",
    "AddedEffect",
    "AugmentedModel",
    "Bias",
    "BreathingTissue",
    "Drift",
    "Effect",
    "Enters",
    "Family",
    "GainError",
    "GivingTissue",
    "LabEffect",
    "LabKey",
    "Memoryless",
    "Reach",
    "SlowTurning",
    "Term",
    "TermEffect",
    "WithTerm",
    "WrapEffect",
    "bent_needle",
    "breathing",
    "effect_columns",
    "effect_named",
    "effects_of",
    "known_effects",
    "lab_key",
    "presliding_of",
    "register_file",
    "speed_factor",
    "weight_curvature",
    "with_effect",
]
