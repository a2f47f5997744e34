"""Catalogue of the effects of the lab twin: the keys of the table `[effects]` of a simulation file.

An effect that models have too has the name and the law of its entry among the effects of the axial force or of the tip;
unit and range of its amplitude are those of that entry. The others need a servo, a random stream or the whole shaft,
which a model of one channel does not have: only the twin can express them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from needleplan.artifacts import CallRepr
from needleplan.models.effects._base import SIZE
from needleplan.models.effects._catalogue import FORCE_EFFECTS
from needleplan.models.effects._tip_catalogue import TIP_EFFECTS

__all__ = ["LAB_EFFECTS", "LabEffect", "LabKey", "lab_key"]

_BY_NAME = {each.name: each for each in (*FORCE_EFFECTS, *TIP_EFFECTS)}
# Smallest value of a time (s) or a length (mm) that is divided by.
_LEAST = 1e-3


@dataclass(frozen=True)
class LabKey:
    """A key of the table `[effects]`: unit, range, meaning, and value if the key is not given."""

    unit: str
    lower: float
    upper: float
    about: str
    default: float | None = 0.0


@dataclass(frozen=True)
class LabEffect(CallRepr):
    """An effect of the lab twin.

    `model_effect` is the name of the effect by which models express the same phenomenon. `same_law` tells whether the
    equation is that of this effect; otherwise `equation` contains more than that of a model. Without such a name, a
    diagnosis sees the effect as noise, as scatter between trials or in other parameters.
    """

    name: str
    equation: str
    keys: Mapping[str, LabKey]
    model_effect: str = ""
    same_law: bool = False


def _amount(unit: str, upper: float, about: str, *, signed: bool = False) -> LabKey:
    return LabKey(unit, -upper if signed else 0.0, upper, about)


def _scale(unit: str, upper: float, about: str, default: float) -> LabKey:
    return LabKey(unit, _LEAST, upper, about, default)


def _amplitude(effect: str, about: str, share: float = 1.0) -> LabKey:
    """Return the key of a share of the amplitude `size` of a model's effect."""
    size = _BY_NAME[effect].parameters[SIZE]
    return LabKey(size.unit, share * size.lower, share * size.upper, about)


def _of_model(effect: str, keys: Mapping[str, LabKey], equation: str = "") -> LabEffect:
    """Return an effect with the law of a model's effect."""
    return LabEffect(effect, equation or _BY_NAME[effect].equation, keys, effect, same_law=True)


_BREATHING = "u = amplitude (sin a - rest/2 cos(a)^2 + rest), a = 2 pi t / period + phase, the phase by seed"

LAB_EFFECTS: tuple[LabEffect, ...] = (
    LabEffect("curvature_error", "k (1 + error + scatter n), n a normal number by seed", {
        "curvature_error": _amount(
            "", 0.95, "relative difference of the true curvature from the planned one", signed=True),
        "curvature_scatter": _amount("", 0.5, "standard deviation of a further relative difference between seeds"),
    }),
    _of_model("curvature_speed", {
        "curvature_speed_power": LabKey("", -1, 1, "size and power of the law: the curvature is k (v / 5 mm/s)^power"),
    }, "k (1 + size ((v / 5 mm/s)^power - 1) / power), power = size"),
    _of_model("pre_bend", {
        "pre_bend_per_mm": _amplitude("pre_bend", "curvature of a bent needle, a quarter turn from the bevel"),
    }),
    _of_model("gravity", {
        "sag_per_mm": _amplitude("gravity", "downward curvature at the entry, by the weight of the needle"),
        "sag_fading_mm": LabKey("mm", 5, 1e4, "inserted length over which it decays; none: that of the shaft", None),
    }),
    LabEffect("heading_noise", "the heading is a random walk along fresh tissue", {
        "heading_noise_rad_sqrt_mm": LabKey("rad/sqrt(mm)", 0, 0.1, "standard deviation of the heading after 1 mm, in "
            "the plane and out of it; none: the tip noise of the plan in an insertion by a table, otherwise 0", None),
    }),
    LabEffect("torsion", "Coulomb friction along the whole shaft (TwistedShaft); its lag is that of Torsion", {
        "torsional_friction_n": _amount("N mm/mm", 10, "torque per inserted length against a rotation"),
        "torsional_release_mm": _amount("mm", 1000, "insertion over which the twist falls to 1/e; 0: it stays"),
    }, "torsional_lag"),
    LabEffect("tissue_motion", "relaxation u' = compliance F(z, v - u') - u, with the friction F of the needle", {
        "tissue_compliance_mm_n": _amount("mm/N", 100, "displacement of the tissue by a friction of 1 N"),
        "tissue_relaxation_s": _scale("s", 100, "damping of the tissue over its stiffness", 0.2),
    }, "tissue_motion"),
    _of_model("respiration", {
        "respiration_along_mm": _amplitude("respiration", "amplitude along the entry, half of the size", 0.5),
        "respiration_period_s": LabKey("s", 0.2, 60, "period, 1/f", 4.0),
        "respiration_rest": LabKey("", -1, 1, "dwell: 0 is a sine, 1 dwells at exhalation, -1 at inhalation"),
    }, _BREATHING),
    _of_model("target_respiration", {
        "respiration_across_mm": _amount("mm", 30, "amplitude across the entry, to the left, half of the size"),
    }, _BREATHING),
    LabEffect("encoder", "the servo measures multiples of a step", {
        "encoder_step_mm": _amount("mm", 0.1, "resolution of the insertion axis; 0: exact"),
        "encoder_step_rad": _amount("rad", 0.1, "resolution of the roll axis; 0: exact"),
    }),
    LabEffect("reaction", "x'' += -reaction F under the servo", {
        "reaction_mm_s2_n": _amount("mm/s^2/N", 1e4, "acceleration of the insertion axis by 1 N: 1 / moved mass"),
    }),
    LabEffect("force_noise", "y += noise, white, before the average of five samples", {
        "force_noise_n": _amount("N", 1, "standard deviation of a sample"),
    }),
    _of_model("bias", {"force_offset_n": _amplitude("bias", "reading at zero force")}),
    _of_model("drift", {"force_drift_n_s": _amplitude("drift", "rate of the zero")}),
    _of_model("gain_error", {"force_gain_error": _amplitude("gain_error", "relative error of the gain")}),
    LabEffect("tracker_noise", "y = p + white + slow, slow' = -slow/time + noise", {
        "tracker_noise_mm": _amount("mm", 5, "standard deviation of each axis, white"),
        "tracker_wander_mm": _amount("mm", 5, "standard deviation of each axis, correlated"),
        "tracker_wander_s": _scale("s", 1000, "time in which the correlation falls to 1/e", 1.0),
        "tracker_angle_noise_rad": _amount("rad", 0.5, "standard deviation of the direction of the coil, each axis"),
    }),
    LabEffect("tracker_field", "y_i = p_i + amplitude sin(2 pi (p_(i+1) + p_i/2)/length + phase_i), phases by seed", {
        "tracker_distortion_mm": _amount("mm", 20, "amplitude of a smooth distortion of the tracker's field"),
        "tracker_distortion_length_mm": _scale("mm", 1e4, "its wavelength", 200.0),
    }, "tracker_distortion"),
    LabEffect("tracker_dropout", "frames without a pose; the duration is exponential", {
        "tracker_dropout": _amount("", 1, "probability that a dropout begins at a frame"),
        "tracker_dropout_s": _scale("s", 60, "mean duration of a dropout", 0.1),
    }),
    LabEffect("fibre_noise", "y = mean over the gauge + bias n + white, n a normal number by seed and sensor", {
        "fibre_noise_per_mm": _amount("1/mm", 0.1, "standard deviation of a curvature sample, white"),
        "fibre_bias_per_mm": _amount("1/mm", 0.1, "standard deviation of the constant error of a sensor"),
    }),
    LabEffect("ultrasound_noise", "y = axes (p(t - delay) - origin) + white, or + outlier n; no detection by chance", {
        "ultrasound_noise_mm": _amount("mm", 20, "standard deviation of each axis of the image, white"),
        "ultrasound_missed": _amount("", 1, "probability that a tip in the slice is not detected"),
        "ultrasound_outliers": _amount("", 1, "probability that a detection is an outlier"),
        "ultrasound_outlier_mm": _scale("mm", 100, "standard deviation of an outlier, each axis", 10.0),
        "ultrasound_delay_s": _amount("s", 2, "age of a position when it arrives"),
    }),
    LabEffect("coil_behind", "y = place and direction of the path at the length l - offset", {
        "coil_offset_mm": _amount("mm", 50, "distance of the coil behind the tip"),
    }, "coil_behind"),
)  # fmt: skip
"""The effects of the lab twin, in the order of display."""


def lab_key(key: str) -> LabKey:
    """Return the declaration of a key of the table `[effects]`."""
    return next(effect.keys[key] for effect in LAB_EFFECTS if key in effect.keys)
