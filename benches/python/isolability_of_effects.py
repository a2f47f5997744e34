"""Which effects of the axial force can motions separate? Each further effect beside those of the default library.

PYTHONPATH=. python benches/python/isolability_of_effects.py > benches/results/isolability_of_effects.md

Motions of the blind campaign with nothing hidden: rich ones (several speeds, rests, reversals) and poor ones (in and
out at one speed). Printed are shares of the squared sensitivity, with the base model projected out: how far the best
effect of the library imitates the further effect, and the other way round.
"""

import numpy as np
from diagnosis_subject import SUBJECTS, SubjectName, records

from needleplan.diagnosis import Isolability, Library, isolability
from needleplan.diagnosis.calibration import calibrate
from needleplan.diagnosis.data import check_data, sensor_noise
from needleplan.models import Channel
from needleplan.models.effects import FURTHER_FORCE_EFFECTS, effects_of
from tests.blind.campaign import Purpose, Stratum, Variety, campaign

HETEROGENEITY_SD = 0.03


def main() -> None:
    """Print the table."""
    found = {variety: separated(variety) for variety in Variety}
    print("| effect | rich motions: imitated by | imitates | poor motions: imitated by | imitates |")
    print("|---|---|---|---|---|")
    for each in FURTHER_FORCE_EFFECTS:
        if each.by_trial:
            continue  # with one phase, it is the breath of the library
        cells = [cell for variety in Variety for cell in row(found[variety], each.name)]
        print(f"| `{each.name}` | {' | '.join(cells)} |")


def separated(variety: Variety) -> Isolability:
    """Return how far the effects imitate each other in the motions of a variety."""
    subject = SUBJECTS[SubjectName.FORCE]
    case = next(each for each in campaign(Purpose.TUNING) if each.stratum is Stratum.NULL and each.variety is variety)
    data, _ = subject.generate(case.spec)
    checked = check_data(records(data), Channel.FORCE)
    calibration = calibrate(subject.base, checked.training, checked.held_out, sensor_noise(subject.base, checked))
    library = Library(effects_of(Channel.FORCE, further=True), subject.base)
    return isolability(calibration, library, HETEROGENEITY_SD)


def row(found: Isolability, name: str) -> list[str]:
    """Return the best imitator of an effect, and the effect that it imitates best, with their shares."""
    index = found.effects.index(name)
    further = {each.name for each in FURTHER_FORCE_EFFECTS}
    places = [place for place, each in enumerate(found.effects) if each not in further]
    cells = []
    for shares in (found.imitated[index, places], found.imitated[places, index]):
        if np.isnan(found.imitated[index]).all():
            cells.append("invisible")
        else:
            best = int(np.nanargmax(shares))
            cells.append(f"`{found.effects[places[best]]}` {shares[best]:.2f}")
    return cells


if __name__ == "__main__":
    main()
