"""Chapter 3 of the thesis: shaft friction; Tables 3.1 to 3.6, Figs. 3.3 and 3.5 to 3.7.

No measured data were published. Every computed number comes from synthetic data, and its comparison names the
generator. A model that is identified from its own data always fits best, so comparisons of models use more than one
generator.
"""
