"""Chapter 5 of the thesis: deflection; Tables 5.1 to 5.3, Figs. 5.1 and 5.2.

The cutting force drives the model and was not published. The radius depends on the force at all depths, so radii and
errors cannot be reproduced. The comparisons check algebra, signs, and the consistency of the printed numbers.
"""
