"""What an insertion depends on besides its table, as texts in its recording and back."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Self

from needleplan.control.options import Options
from needleplan.control.safety import SafetyLimits
from needleplan.errors import DataError, InputError
from needleplan.estimation.registration import Registration
from needleplan.estimation.tip import TipSettings
from needleplan.models import Torsion

__all__ = ["RunSetup"]

_OPTIONS, _LIMITS, _TIP, _REGISTRATION = "options.json", "limits.json", "tip_settings.json", "registration.toml"


@dataclass(frozen=True)
class RunSetup:
    """Options, limits, registration and the settings of the tip filter."""

    options: Options = field(default_factory=Options)
    limits: SafetyLimits = field(default_factory=SafetyLimits)
    registration: Registration = field(default_factory=Registration)
    tip_settings: TipSettings = field(default_factory=TipSettings)

    @property
    def digests(self) -> dict[str, str]:
        """SHA-256 of what has one."""
        return {"registration": self.registration.digest}

    @property
    def texts(self) -> dict[str, str]:
        """All of it as files of a recording."""
        parts = {_OPTIONS: asdict(self.options), _LIMITS: asdict(self.limits), _TIP: asdict(self.tip_settings)}
        texts = {name: json.dumps(part, indent=1) for name, part in parts.items()}
        return texts | {_REGISTRATION: self.registration.to_toml()}

    @classmethod
    def from_texts(cls, texts: Mapping[str, str], source: str = "") -> Self:
        """Return what `texts` gave. Raises DataError where it is missing or cannot be."""
        try:
            options: dict[str, Any] = json.loads(texts[_OPTIONS])
            if options["torsion"] is not None:
                options["torsion"] = Torsion(**options["torsion"])
            for name in ("force_axis", "expected_start"):
                options[name] = options[name] and tuple(options[name])
            return cls(
                Options(**options),
                SafetyLimits(**json.loads(texts[_LIMITS])),
                Registration.from_toml(texts[_REGISTRATION]),
                TipSettings(**json.loads(texts[_TIP])),
            )
        except KeyError as error:
            raise DataError(f"is not the recording of an insertion: it has no {error}", source) from error
        except (ValueError, TypeError, InputError) as error:
            raise DataError(f"does not say how the insertion was set up: {error}", source) from error
