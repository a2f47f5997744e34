"""
Axial force identified from recordings
======================================

Three simulated insertions with noise, one of them held out: the identified model, its parts and its residuals.
"""

import numpy as np
from matplotlib import pyplot

from needleplan.identification import force
from needleplan.identification.force_library import ForceLibrary
from needleplan.models import simulate
from needleplan.signals import Record, Role, insertion_cycles

true = ForceLibrary.read("published").combinations[0].model
random = np.random.default_rng(0)
trials = []
for name, velocity_mm_s, role in (
    ("first", 10.0, Role.TRAIN),
    ("second", 8.0, Role.TRAIN),
    ("third", 9.0, Role.HOLDOUT),
):
    motion = insertion_cycles(80.0, velocity_mm_s)
    noisy = simulate(true, motion).output + random.normal(0, 0.01, len(motion))
    columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    trials.append(Record({**columns, "force_n": noisy}, name, role))
found = force.identify(trials)
found.draw(pyplot.figure(figsize=(9, 6.4), layout="constrained"))
