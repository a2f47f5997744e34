"""Chapter 6 of the thesis: prioritized-partitioned value iteration; Tables 6.2 and 6.3, Figs. 6.3 to 6.9, section 6.5.

The thesis prints no coordinates of its obstacles. The scenes here are assumed, so results that depend on them cannot
equal the published ones; each comparison states this.
"""
