"""Chapter 2 of the thesis: axial force by depth, identified by Kalman filters; Tables 2.1-2.3, Figs. 2.2-2.9.

The measurements of the thesis are not published. The records here are simulated (`forces.insertion_record`): Model II
with the published parameters, and the disturbances that the text names. Errors can therefore not equal the published
ones; each comparison states this.
"""
