"""Options of an insertion, and the setup that a recording stores as texts."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self

from needleplan.artifacts import CallRepr
from needleplan.config import Integer, Number, Rule, mistakes_of
from needleplan.control._gate import BreathGate
from needleplan.control.safety import SafetyLimits
from needleplan.errors import DataError, InputError, Mistake
from needleplan.estimation.registration import Registration, not_refused
from needleplan.estimation.tip import TipSettings
from needleplan.models import Torsion
from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.models.tissue import NeedlePush, TargetPush
from needleplan.planning import Table, planned_noise

__all__ = ["Options", "RunSetup", "planned_tip_settings"]

_POSITIVE = (
    "velocity_mm_s", "velocity_rad_s", "longest_mm", "needle_length_mm", "silence_s", "replan_deviations",
)  # fmt: skip
_NOT_NEGATIVE = ("lead_s", "replan_share", "resume_s", "roll_tolerance_rad", "settling_frames")
_RULES: dict[str, Rule] = {
    **dict.fromkeys(_POSITIVE, Number(above=0)),
    **dict.fromkeys(_NOT_NEGATIVE, Number(at_least=0)),
    **dict.fromkeys(("entry_depth_mm", "roll_left_rad", "start_within_mm", "start_within_rad"), Number()),
    "decisions_per_step": Integer(1, 100),
    "plane_roll_rad": Number("rad", at_least=0, at_most=1),
    "least_success": Number(at_least=0, at_most=1),
}
_OPTIONS, _LIMITS, _TIP, _REGISTRATION = "options.json", "limits.json", "tip_settings.json", "registration.toml"
_ACCEPTED = "accepted_limits.txt"
_FIBRE, _PLANE = "fibre.json", "ultrasound.json"


@dataclass(frozen=True)
class Options(CallRepr):
    """Options of an insertion; lengths in mm, angles in rad. Raises InputError with every invalid option."""

    velocity_mm_s: float = 5.0
    """Insertion speed (mm/s); the thesis uses up to 12 mm/s."""

    velocity_rad_s: float = 3.0
    """Rotation speed (rad/s); the thesis uses 3 turns a minute, a tenth of the default."""

    entry_depth_mm: float = 0.0
    """Stage depth at which the tip is at the entry."""

    homed_by: str = ""
    """Name of the person who has homed the stage for this run; needed after the stage has lost its zero."""

    roll_left_rad: float = 0.0
    """Stage roll at which the needle bends to the left."""

    longest_mm: float = 180.0
    """Path length at which the insertion ends without success."""

    torsion: Torsion | None = None
    """Model of the torsional lag to compensate; None if the tip turns exactly with the base."""

    needle_length_mm: float = 200.0
    """Length of the needle; the torsional lag depends on it."""

    stops: bool = False
    """Whether the needle stops after every step; otherwise it stops only before rotations and at the end."""

    lead_s: float = 0.15
    """Time (s) before the end of a step at which the next decision is made. Choose at least the stopping time of the
    stage; this is not checked."""

    settling_frames: int = 4
    """Number of usable tracker frames for which the loop waits after the needle has stopped."""

    least_success: float = 0.01
    """Success probability in the table below which the insertion ends."""

    replan: bool = True
    """Whether to plan again if the estimated curvature differs too much from the planned curvature."""

    replan_deviations: float = 3.0
    """Difference between estimated and planned curvature, in standard deviations of the estimate, above which the loop
    plans again. The difference must also exceed `replan_share`."""

    replan_share: float = 0.04
    """Difference between estimated and planned curvature, as a share of the planned curvature, above which the loop
    plans again; a smaller difference hardly changes a policy."""

    plane_roll_rad: float = 0.35
    """Largest roll of the bevel out of the plane, with which the loop brings the tip back to the plane; 0: none. At
    the default, the curvature in the plane is smaller by 6 %."""

    roll_tolerance_rad: float = 0.1
    """In 3D: difference between the wanted and the estimated roll of the bevel up to which the needle is not stopped
    for a rotation. At the default, the lateral curvature is wrong by 10 %."""

    decisions_per_step: int = 2
    """In 3D: number of decisions in a step of the plan. The plan decides once in a step; the tip is disturbed all
    along, so that further decisions, and rotations, correct it earlier."""

    silence_s: float = 1.0
    """Time (s) without a sample of any device after which the run ends with a fault."""

    expected_start: tuple[float, ...] | None = None
    """Expected pose of the entry: x_mm, y_mm, heading_rad, and in 3D z_mm, elevation_rad. The run is refused if the
    measured pose is too far away. None: every pose is accepted."""

    start_within_mm: float = 5.0
    """Largest accepted distance (mm) of the measured entry from `expected_start`."""

    start_within_rad: float = 0.2
    """Largest accepted angle (rad) between the measured direction and that of `expected_start`."""

    resume_s: float = 5.0
    """Longest pause (s), for example while the tracker does not see the coil; a longer pause ends the run with a fault.
    By starting the run, the operator allows the loop to resume when no cause is present and the stage rests. 0: a pause
    ends the run, unless its cause has already gone. A fault always ends the run. A pause or a retraction that a person
    orders has no time limit: only a person resumes the run."""

    push: TargetPush | None = None
    """Push of the needle, which moves the target ahead: the tip goes on beyond the place at rest. None: no push."""

    gate: BreathGate | None = None
    """In 3D: when the needle may advance, by breathing; None: at any time."""

    force_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Unit vector in the frame of the force sensor, in the direction of a force that resists insertion."""

    def __post_init__(self) -> None:
        mistakes = mistakes_of(self, _RULES)
        length = math.hypot(*self.force_axis)
        if not 0.999 < length < 1.001:
            mistakes.append(Mistake("force_axis", str(self.force_axis), "must be a vector of length 1"))
        if mistakes:
            raise InputError(mistakes, "options of the insertion")


@dataclass(frozen=True)
class RunSetup(CallRepr):
    """Everything besides the table that an insertion depends on: options, limits, registration, tip settings.

    `fibre` and `plane` are the curvature sensors of the needle and the image plane of an ultrasound probe, if any.

    `accepted` is the reason for which a person accepts limits that are laxer than the defaults; empty without one.
    """

    options: Options = field(default_factory=Options)
    limits: SafetyLimits = field(default_factory=SafetyLimits)
    registration: Registration = field(default_factory=Registration)
    tip_settings: TipSettings = field(default_factory=TipSettings)
    accepted: str = ""
    fibre: FibreSensors | None = None
    plane: ImagePlane | None = None

    @property
    def digests(self) -> dict[str, str]:
        """Digest of the registration, under the name `registration`."""
        return {"registration": self.registration.digest}

    @property
    def texts(self) -> dict[str, str]:
        """The setup as texts for a recording, by file name: JSON, and TOML for the registration."""
        parts = {_OPTIONS: asdict(self.options), _LIMITS: asdict(self.limits), _TIP: asdict(self.tip_settings)}
        texts = {name: json.dumps(part, indent=1) for name, part in parts.items()}
        texts |= {_ACCEPTED: self.accepted} if self.accepted else {}
        sensors = {_FIBRE: self.fibre, _PLANE: self.plane}
        texts |= {name: json.dumps(asdict(part), indent=1) for name, part in sensors.items() if part}
        return texts | {_REGISTRATION: self.registration.to_toml()}

    @classmethod
    def from_texts(cls, texts: Mapping[str, str], source: str = "") -> Self:
        """Return the setup that the texts of a recording store.

        Parameters
        ----------
        texts : mapping
            Texts by file name.
        source : str, optional
            Name of the recording in messages.

        Returns
        -------
        RunSetup

        Raises
        ------
        DataError
            A file is missing or invalid.
        """
        try:
            options: dict[str, Any] = json.loads(texts[_OPTIONS])
            if options["torsion"] is not None:
                options["torsion"] = Torsion(**options["torsion"])
            if options.get("gate") is not None:
                options["gate"] = BreathGate.from_record(options["gate"])
            if options.get("push") is not None:
                options["push"] = TargetPush(NeedlePush(**options["push"].pop("tissue")), **options["push"])
            for name in ("force_axis", "expected_start"):
                options[name] = options[name] and tuple(options[name])
            return cls(
                Options(**options),
                SafetyLimits(**json.loads(texts[_LIMITS])),
                not_refused(Registration.from_toml(texts[_REGISTRATION], _REGISTRATION), _REGISTRATION),
                TipSettings(**json.loads(texts[_TIP])),
                texts.get(_ACCEPTED, ""),
                FibreSensors(**json.loads(texts[_FIBRE])) if _FIBRE in texts else None,
                ImagePlane(**json.loads(texts[_PLANE])) if _PLANE in texts else None,
            )
        except KeyError as error:
            raise DataError(f"is not the recording of an insertion: it has no {error}", source) from error
        except (ValueError, TypeError, InputError) as error:
            raise DataError(f"contains an invalid setup of the insertion: {error}", source) from error


def planned_tip_settings(table: Table, noise_rad_sqrt_mm: float | None = None) -> TipSettings:
    """Return the settings of the tip filter for a plan: its tip noise where it exceeds the default of the filter.

    Parameters
    ----------
    table : Table
        The plan.
    noise_rad_sqrt_mm : float, optional
        Tip noise of the needle where it is known, as in a simulated lab. Default: that of the plan.

    Returns
    -------
    TipSettings
    """
    usual, noise = TipSettings(), noise_rad_sqrt_mm
    if noise is None:
        noise = planned_noise(table.scenario).in_plane_rad_sqrt_mm
    return replace(usual, heading_sd_rad_sqrt_mm=max(usual.heading_sd_rad_sqrt_mm, noise))
