"""The channels that can be diagnosed."""

from __future__ import annotations

from needleplan.diagnosis.axial_force import AXIAL_FORCE
from needleplan.diagnosis.measurand import Measurand
from needleplan.diagnosis.tip_position import TIP_POSITION
from needleplan.errors import Mistake, ModelError
from needleplan.models import Channel

__all__ = ["MEASURANDS", "measurand_of"]

MEASURANDS: dict[Channel, Measurand] = {each.channel: each for each in (AXIAL_FORCE, TIP_POSITION)}


def measurand_of(channel: Channel) -> Measurand:
    """Return what is known of a channel. Raises ModelError for one that cannot be diagnosed."""
    if channel not in MEASURANDS:
        rule = f"cannot be diagnosed; must be one of {', '.join(MEASURANDS)}"
        raise ModelError(Mistake("channel", channel, rule))
    return MEASURANDS[channel]
