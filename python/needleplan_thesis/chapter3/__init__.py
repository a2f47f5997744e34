"""Chapter 3 of the thesis: shaft friction; Tables 3.1 to 3.6, Figs. 3.3 and 3.5 to 3.7.

No measured data were published. Every number of ours comes from synthetic data, whose generator the comparison names; a
model that is identified on data of its own making always wins, so the rows about data name more than one generator.
"""
