"""
Friction of the shaft
=====================

The LuGre model with the published parameters of a needle that moves to and fro through tissue: force over velocity.
Bristles make the loop; the force changes its sign only after the presliding.
"""

from matplotlib import pyplot

from needleplan.models import simulate
from needleplan.signals import sinusoid
from needleplan_thesis.chapter3.published import model_ii, model_iii_b

pyplot.style.use("tableau-colorblind10")
motion = sinusoid(offset_mm=126, amplitude_mm=25, frequency_hz=0.05, cycles=2)
second = slice(4001, None)  # the first cycle has the transient

figure, axes = pyplot.subplots(figsize=(6.4, 4.4), layout="constrained")
for title, model, style in (("Model II", model_ii(1), "-"), ("Model III-B", model_iii_b(1), "--")):
    force_n = simulate(model, motion).output
    axes.plot(motion.velocity_mm_s[second], force_n[second], style, label=title)
axes.set(xlabel="velocity (mm/s)", ylabel="friction (N)")
axes.legend(frameon=False)
