"""
Tissue that moves with the needle
=================================

Tissue sticks to the shaft and follows it. The velocity of the needle, and its velocity relative to the tissue, which
the friction depends on.
"""

from matplotlib import pyplot

from needleplan.models import LumpedOnTissue, simulate
from needleplan.signals import sinusoid

motion = sinusoid(offset_mm=126, amplitude_mm=40, frequency_hz=0.1, cycles=3)
model = LumpedOnTissue(
    alpha=0.088, sigma0=1.203, sigma1=0.374, sigma2=0.014, mu_s=0.033, mu_c=0.788, stiffness=0.13, damping=0.02
)
done = simulate(model, motion)

figure, (speed, force) = pyplot.subplots(2, 1, figsize=(7.6, 5), layout="constrained", sharex=True)
speed.plot(motion.time_s, motion.velocity_mm_s, color="#0072B2", label="needle")
speed.plot(motion.time_s, motion.velocity_mm_s - done.states[2], "--", color="#D55E00", label="needle on tissue")
speed.set(ylabel="velocity (mm/s)")
speed.set_ylim(top=1.35 * speed.get_ylim()[1])
speed.legend(frameon=False, loc="upper right", ncols=2)
force.plot(motion.time_s, done.output, color="#1a1a1a")
force.set(xlabel="time (s)", ylabel="force (N)")
