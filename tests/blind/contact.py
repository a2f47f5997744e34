"""Needle and tissue in contact: elements fixed in the tissue along the path, each with a bristle and a node.

An element between X and X + WIDTH_MM is covered by the needle as far as the tip has come. Its bristle has a state q in
[-1, 1] that follows the slip r of the needle past the node, dq/dr = sign dr (1 - q sign dr) / length; its visco-elastic
node gives way by u with lag u' + u = give q. Force of the element: density x covered length x q. Fresh contact begins
with q = 0.
The last column is the tip: a bristle of its own that is always in contact and begins unloaded (-1).
"""

from dataclasses import dataclass

import numpy as np

from tests.blind.motions import STEP_S, Array

WIDTH_MM = 1.25
ELEMENTS = 64  # 80 mm of path
EDGES_MM = WIDTH_MM * np.arange(ELEMENTS)
CENTRES_MM = EDGES_MM + WIDTH_MM / 2
_NEWTON_STEPS = 3


@dataclass(frozen=True)
class Compliance:
    """Of R trials: bristle lengths, give of the nodes at full friction in mm (R, ELEMENTS + 1), their lag in s."""

    bristle_mm: Array
    give_mm: Array
    lag_s: float


@dataclass(frozen=True)
class Contact:
    """States over T steps of R trials; covered length in mm, bristle and slip in mm a step are (T, R, ELEMENTS)."""

    covered_mm: Array
    bristle: Array
    slip_mm: Array
    tip: Array  # (T, R)


def touch(tip_mm: Array, compliance: Compliance) -> Contact:
    """Contact while the tip moves as tip_mm (T, R) relative to the tissue at rest.

    Each step is implicit in the node and exact in the bristle for the slip p >= 0 in its direction s:
    alpha p + give (1 - (1 - s q) exp(-p / length)) = s B, with alpha = 1 + lag / step, B = u + alpha dx. The left
    side is increasing and concave, so Newton's steps from p = 0 approach the root from below without overshoot.
    """
    steps, trials = tip_mm.shape
    covered = np.clip(tip_mm[..., None] - EDGES_MM, 0.0, WIDTH_MM)
    kept = np.ones((steps, trials, ELEMENTS + 1))  # share of the contact that was there a step ago
    kept[1:, :, :-1] = np.minimum(1.0, covered[:-1] / np.maximum(covered[1:], 1e-12))
    kept[1:, :, :-1][covered[1:] == 0.0] = 0.0
    moved = np.diff(tip_mm, axis=0)[..., None]
    length, give = compliance.bristle_mm, compliance.give_mm
    alpha = 1.0 + compliance.lag_s / STEP_S
    inverse, steep = 1.0 / length, give / length
    state = np.zeros((trials, ELEMENTS + 1))
    state[:, -1] = -1.0
    node = np.zeros_like(state)
    bristles, slips = np.zeros_like(kept), np.zeros_like(kept)
    bristles[0] = state
    for k in range(1, steps):
        state = state * kept[k]
        drive = node + alpha * moved[k - 1]
        sign = np.where(give * state < drive, 1.0, -1.0)
        along, goal = sign * state, sign * drive
        unloaded = 1.0 - along
        slip = (goal - give * along) / (alpha + steep * unloaded)
        for _ in range(_NEWTON_STEPS - 1):
            decayed = unloaded * np.exp(-slip * inverse)
            slip = slip + (goal - alpha * slip - give * (1.0 - decayed)) / (alpha + steep * decayed)
        state = sign * (1.0 - unloaded * np.exp(-slip * inverse))
        signed = sign * slip
        node = node + moved[k - 1] - signed
        bristles[k], slips[k] = state, signed
    return Contact(covered, bristles[..., :-1], slips[..., :-1], bristles[..., -1])
