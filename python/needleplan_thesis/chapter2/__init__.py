"""Chapter 2 of the thesis: axial force by depth, identified by Kalman filters; Tables 2.1-2.3, Figs. 2.2-2.9.

The thesis' measurements are not published. The records here are made by `generator`: Model II with the published
parameters, disturbed by what the text says disturbed theirs. So no error can equal a published one, and every
comparison says so.
"""
