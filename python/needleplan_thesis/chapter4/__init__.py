"""Chapter 4 of the thesis: tissue motion; section 4.3, Figures 4.3 to 4.6.

No measured data are published. The trials here are synthetic; `phantoms` describes how they are simulated.
"""
