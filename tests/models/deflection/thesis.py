"""The needle and the gels of chapter 5, with the numbers as printed, and beams made with them."""

import math
from dataclasses import replace

import numpy as np

from needleplan.models import NeedleShaft
from needleplan.models.deflection import AxialTerms, Beam, ElasticTissue

NEEDLE = NeedleShaft(0.718, 0.413, 203.0, math.radians(24.8))
SOFT = ElasticTissue(3.87e-3, 123.9e-6)
STIFF = ElasticTissue(7.65e-3, 166.7e-6)
COIL_MM = 9.3
PRINTED_BENDING_N_MM2 = 200e3 * 1.162e-2
"""EI from the second moment as the thesis rounds it; the oracles were computed with it."""


def beam(tissue: ElasticTissue, depth_mm: float, force_n: float, velocity_mm_s: float, terms: AxialTerms) -> Beam:
    made = Beam.of(NEEDLE, tissue, depth_mm, force_n, velocity_mm_s, terms=terms)
    return replace(made, bending_n_mm2=np.asarray(PRINTED_BENDING_N_MM2))
