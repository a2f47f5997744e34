"""Chapter 5 of the thesis: deflection; Tables 5.1 to 5.3, Figs. 5.1 and 5.2.

The cutting force, the only thing that drives the model, was not published, and the radius depends on its whole course.
So radii and errors cannot be reproduced; what can be checked is algebra, signs, and whether the numbers fit each other.
"""
