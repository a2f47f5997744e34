"""The atlas: identified needle-tissue combinations, to be searched and used where there is no force sensor."""

from needleplan.estimation.atlas.atlas import Atlas, Match, published_atlas
from needleplan.estimation.atlas.combination import Combination, Prediction

__all__ = ["Atlas", "Combination", "Match", "Prediction", "published_atlas"]
