"""Diagnosis: where simulation and measurement disagree, what is missing, how much of it, and whether that is enough.

| stage | here |
|---|---|
| check the data | `needleplan.diagnosis.check` |
| noise, and every parameter of the base | `noise`, `calibrate`, `variation` |
| every effect over its grid, and competitors without a name | `library`, `screen`, `rivals`; their algebra is `space` |
| one effect after the other, through all gates | `rounds`, `step`, `refit`, `verify` |
| the set of them, each judged beside the others | `select` |
| the verdict | `decide`, `verdict` |
| what would have been seen | `minimal` |
"""

from needleplan.diagnosis.decide import Decision
from needleplan.diagnosis.diagnosis import Diagnosis, FoundEffect
from needleplan.diagnosis.library import Library
from needleplan.diagnosis.measurand import Axis
from needleplan.diagnosis.stages import diagnose
from needleplan.diagnosis.verdict import Gates, Verdict

__all__ = ["Axis", "Decision", "Diagnosis", "FoundEffect", "Gates", "Library", "Verdict", "diagnose"]
