"""What a hidden effect may do: move the tissue, change the contact, add friction or force, or spoil the sensor."""

from abc import ABC
from dataclasses import dataclass
from enum import StrEnum

from tests.blind.base import Scene
from tests.blind.contact import Compliance
from tests.blind.hidden import Hidden
from tests.blind.motions import Array


class ForceName(StrEnum):
    """Hidden effects of the axial force; those from SLIP_STEP on are outside of any library."""

    PUNCTURE = "puncture"
    FRICTION_LAYER = "friction_layer"
    CUTTING_LAYER = "cutting_layer"
    FRESH_CUTTING = "fresh_cutting"
    CUTTING_DEPTH = "cutting_depth"
    STRIBECK = "stribeck"
    BRISTLE = "bristle"
    TISSUE_MOTION = "tissue_motion"
    VISCOUS = "viscous"
    BIAS = "bias"
    DRIFT = "drift"
    THERMAL_DRIFT = "thermal_drift"
    GAIN = "gain"
    LATENCY = "latency"
    RELAXATION = "relaxation"
    INERTIA = "inertia"
    RESPIRATION = "respiration"
    PATH_DAMAGE = "path_damage"
    BUMPS = "bumps"
    SLIP_STEP = "slip_step"
    MOTOR_RIPPLE = "motor_ripple"
    BUCKLING = "buckling"
    GAIN_CURVE = "gain_curve"
    ENTRY_SPRING = "entry_spring"
    SPEED_CROSSTALK = "speed_crosstalk"
    AGEING = "ageing"
    VIBRATION = "vibration"


@dataclass(frozen=True)
class Effect(Hidden, ABC):
    """A hidden effect of the axial force."""

    def tissue_mm(self, time_s: Array) -> Array | None:
        """Motion of the tissue along the path (T,), positive inwards."""
        del time_s
        return None

    def compliance(self, usual: Compliance) -> Compliance:
        return usual

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array | float:
        """Force on the needle beside the friction and the cutting of the base, (T, R)."""
        del scene, friction_n, cutting_n
        return 0.0

    def reading_n(self, scene: Scene, force_n: Array) -> Array | float:
        """What the sensor shows beside the force that acts on it (T, R), before its filter."""
        del scene, force_n
        return 0.0
