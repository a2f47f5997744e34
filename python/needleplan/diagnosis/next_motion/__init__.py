"""The motion to measure next: one more trial, chosen to answer the question that the diagnosis left open.

| verdict | the motion |
|---|---|
| ambiguous | separates the effects that explain the data equally well (`Separating`) |
| unknown, incomplete | gives most information on the gap along its axis (`Exploring`) |
| underpowered | lowers the detection limits most (`Revealing`) |
"""

from needleplan.diagnosis.next_motion._choice import limits_of, next_motion, separations
from needleplan.diagnosis.next_motion._explore import Exploring
from needleplan.diagnosis.next_motion._programs import (
    Dwell,
    Insert,
    Limits,
    NextMotion,
    Program,
    Rotate,
    programs,
    recorded_limits,
)
from needleplan.diagnosis.next_motion._reveal import Revealed, Revealing
from needleplan.diagnosis.next_motion._separate import NOTHING, Separating, Separation, Synonyms

__all__ = [
    "NOTHING",
    "Dwell",
    "Exploring",
    "Insert",
    "Limits",
    "NextMotion",
    "Program",
    "Revealed",
    "Revealing",
    "Rotate",
    "Separating",
    "Separation",
    "Synonyms",
    "limits_of",
    "next_motion",
    "programs",
    "recorded_limits",
    "separations",
]
