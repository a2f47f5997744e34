"""All effects by name: those of this package, and those of others by the entry points `needleplan.effects`.

An entry point names an object of a member of `Effect`, or a class that makes one without arguments.
"""

from __future__ import annotations

import runpy
from difflib import get_close_matches
from functools import lru_cache
from importlib import metadata

from needleplan.errors import Mistake, ModelError
from needleplan.models.base import Channel
from needleplan.models.effects.base import SIZE, Effect
from needleplan.models.effects.catalogue import FORCE_EFFECTS
from needleplan.models.effects.tip_catalogue import TIP_EFFECTS
from needleplan.models.parameter import Scale

__all__ = ["GROUP", "effect_named", "effects_of", "known_effects", "register_file"]

GROUP = "needleplan.effects"


@lru_cache(maxsize=1)
def known_effects() -> dict[str, Effect]:
    """Return all effects by name. Raises ModelError for a plug-in that is none, or takes another one's name."""
    found = {each.name: each for each in (*FORCE_EFFECTS, *TIP_EFFECTS)}
    for point in metadata.entry_points(group=GROUP):
        made = point.load()
        effect = made() if isinstance(made, type) else made
        if not isinstance(effect, Effect) or SIZE not in effect.parameters:
            raise ModelError(Mistake(point.name, str(made), f"must be an Effect with a parameter {SIZE}"), GROUP)
        if effect.name in found:
            raise ModelError(Mistake(point.name, effect.name, "is the name of another effect"), GROUP)
        found[effect.name] = effect
    return found


def register_file(path: str) -> Effect:
    """Make the effect of a Python file known to this process, and return it: `EFFECT`, or a class of that name.

    The file is run. Raises ModelError where it cannot be, holds no effect, or takes another one's name.
    """
    found: list[Mistake] = []
    try:
        made = runpy.run_path(path).get("EFFECT")
        effect = made() if isinstance(made, type) else made
        if not isinstance(effect, Effect) or SIZE not in effect.parameters:
            found.append(Mistake("EFFECT", "", f"must be there, an Effect with a parameter {SIZE}"))
        elif effect.name in known_effects() and known_effects()[effect.name] is not effect:
            found.append(Mistake("EFFECT", effect.name, "is the name of another effect"))
        elif effect.parameters[SIZE].scale is not Scale.LINEAR:
            found.append(Mistake("EFFECT", effect.name, f"{SIZE} must be able to be 0: give it a typical value"))
        else:
            known_effects()[effect.name] = effect
            return effect
    except OSError as error:
        found.append(Mistake("", "", f"cannot be read: {error.strerror}"))
    except (Exception, SystemExit) as error:  # whatever a file of somebody else does
        line = f"{type(error).__name__}: {error}"
        raise ModelError(Mistake("EFFECT", "", f"cannot be made, {line}"), path) from error
    raise ModelError(found, path)


def effects_of(channel: Channel) -> tuple[Effect, ...]:
    """Return the effects of a channel."""
    return tuple(each for each in known_effects().values() if each.channel is channel)


def effect_named(name: str) -> Effect:
    """Return an effect. Raises ModelError with a suggestion."""
    known = known_effects()
    if name in known:
        return known[name]
    close = get_close_matches(name, known, n=1)
    rule = f"must be one of {', '.join(sorted(known))}"
    raise ModelError(Mistake("effect", name, rule + (f'; did you mean "{close[0]}"?' if close else "")))
