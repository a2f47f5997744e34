"""Identification: models of the mechanics from recordings. Each kind of model has a module with `identify`."""

import needleplan.extras.lab  # noqa: F401  # raises MissingLibraryError
from needleplan.identification._circle import Circle, CircleMethod, fit_circle
from needleplan.identification._force_record import Drop, force_drops
from needleplan.identification._identification import Finding, Identification
from needleplan.identification._passes import (
    FilterRun,
    FilterStatus,
    Recipe,
    Track,
    feed,
    identify_by_passes,
    mean_absolute_error,
    replay,
)
from needleplan.identification._path_curvature import (
    Curvature,
    CurvatureChange,
    PathForm,
    TrackerNoise,
    arc_curvature,
    path_curvature,
)
from needleplan.identification._tip_noise import NoiseStatus, TipNoise, headings_at, tip_noise
from needleplan.identification.path_end import PredictedEnd, predict_end
from needleplan.identification.population import InsertionForecast, new_series, next_insertion
from needleplan.models.trials import (
    TrialAgreement,
    TrialMean,
    TrialRegression,
    agreement_of,
    combine,
    mean_estimate,
    regress,
)

__all__ = [
    "Circle",
    "CircleMethod",
    "Curvature",
    "CurvatureChange",
    "Drop",
    "FilterRun",
    "FilterStatus",
    "Finding",
    "Identification",
    "InsertionForecast",
    "NoiseStatus",
    "PathForm",
    "PredictedEnd",
    "Recipe",
    "TipNoise",
    "Track",
    "TrackerNoise",
    "TrialAgreement",
    "TrialMean",
    "TrialRegression",
    "agreement_of",
    "arc_curvature",
    "combine",
    "feed",
    "fit_circle",
    "force_drops",
    "headings_at",
    "identify_by_passes",
    "mean_absolute_error",
    "mean_estimate",
    "new_series",
    "next_insertion",
    "path_curvature",
    "predict_end",
    "regress",
    "replay",
    "tip_noise",
]
