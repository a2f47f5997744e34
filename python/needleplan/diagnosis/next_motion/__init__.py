"""What to measure next: one more motion, chosen for what the diagnosis could not say.

| verdict | the motion that |
|---|---|
| ambiguous | tells the effects apart that are left (`separate`) |
| unknown, incomplete | shows most of the gap along its axis (`explore`) |
| underpowered | lets the smallest effects be seen (`reveal`) |
"""

from needleplan.diagnosis.next_motion.explore import Exploring
from needleplan.diagnosis.next_motion.proposal import NextMotion
from needleplan.diagnosis.next_motion.propose import limits_of, next_motion, separations
from needleplan.diagnosis.next_motion.reveal import Revealed, Revealing
from needleplan.diagnosis.next_motion.separate import NOTHING, Separating, Separation, Synonyms

__all__ = [
    "NOTHING",
    "Exploring",
    "NextMotion",
    "Revealed",
    "Revealing",
    "Separating",
    "Separation",
    "Synonyms",
    "limits_of",
    "next_motion",
    "separations",
]
