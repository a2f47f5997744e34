"""
A hidden effect found
=====================

A needle with viscous friction that its model lacks. The diagnosis names the effect from two recordings and checks it
in a third: the gap between measurement and model before, and after.
"""

import numpy as np
from matplotlib import pyplot

import needleplan as npl
from needleplan.models import ShaftAndTip, simulate
from needleplan.models.effects import effect_named
from needleplan.signals import Record, Role, lspb

base = ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05)
hidden = effect_named("viscous").apply(base, {"size": 3e-4})
random = np.random.default_rng(0)


def trial(name, role, depths, speeds):
    """Return a recording of the needle with the hidden effect."""
    motion = lspb(depths, speeds, rate_hz=50)
    force = simulate(hidden, motion).output + random.normal(0, 0.02, len(motion))
    columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    return Record({**columns, "force_n": force}, name, role)


still = {"time_s": np.arange(1000) / 50, "force_n": random.normal(0, 0.02, 1000)}
recordings = [
    trial("first", Role.TRAIN, [-2, 30, 20, 60, -2], [4, 8, 6, 12]),
    trial("second", Role.TRAIN, [-2, 45, 35, 60, -2], [9, 5, 3, 10]),
    trial("third", Role.HOLDOUT, [-2, 20, 60, -2], [10, 4, 8]),
    Record(still, "air", Role.NOISE),
]
found = npl.diagnose(base, recordings)
print(found.verdict, found.names)

held_out = recordings[2]
motion = lspb([-2, 20, 60, -2], [10, 4, 8], rate_hz=50)
figure, axes = pyplot.subplots(figsize=(7.6, 4), layout="constrained")
for label, model, colour in (("before", base, "#D55E00"), ("after", found.model, "#0072B2")):
    gap_n = held_out["force_n"] - simulate(model, motion).output
    axes.plot(motion.time_s, gap_n, color=colour, linewidth=0.7, label=f"{label}: rms {1e3 * gap_n.std():.0f} mN")
axes.set(xlabel="time (s)", ylabel="measured less simulated force (N)", title="the recording that was held out")
axes.legend(frameon=False, loc="upper left")
