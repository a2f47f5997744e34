"""The option `--buckling` of `needleplan insert`: warnings where the shaft can buckle outside of the tissue."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from needleplan.cli.options import numbers
from needleplan.errors import InputError, Mistake

__all__ = ["buckling_warnings"]

# Spacing of the depths (mm) at which the force of the model is compared.
_EVERY_MM = 0.5


def buckling_warnings(options: argparse.Namespace, length_mm: float, force_limit_n: float) -> Iterator[str]:
    """Yield a warning if the force limit, or the force of `--force-model`, exceeds the buckling load.

    The force of the model is that of an insertion at `--speed` along the planned path of `length_mm`. Raises InputError
    for wrong options and files.
    """
    import numpy as np

    from needleplan.models import Channel, ModelFile, simulate
    from needleplan.models.deflection import UnsupportedShaft
    from needleplan.signals import Motion

    if not options.buckling:
        if options.force_model:
            rule = "requires --buckling: the force is compared with the buckling load"
            raise InputError(Mistake("--force-model", options.force_model, rule))
        return
    stiffness_n_mm2, free_mm = numbers("--buckling", options.buckling, 2)
    shaft = UnsupportedShaft(stiffness_n_mm2, free_mm)
    if (load := float(shaft.buckling_n(0.0))) < force_limit_n:
        yield (
            f"the shaft buckles at {load:.2f} N with {shaft.length_mm:g} mm unsupported, but the run stops at "
            f"{force_limit_n:g} N; up to a depth of {shaft.holds_from_mm(force_limit_n):.0f} mm the force limit does "
            "not protect it: shorten the unsupported length by a guide, or lower safety.force_n"
        )
    if not options.force_model:
        return
    model = ModelFile.read(options.force_model).model
    if model.channel is not Channel.FORCE:
        raise InputError(Mistake("--force-model", options.force_model, "must be a model of the axial force"))
    depth = np.arange(0.0, length_mm + _EVERY_MM, _EVERY_MM)
    force = simulate(model, Motion.sampled(depth / options.speed, depth)).output
    (over,) = np.nonzero(force > shaft.buckling_n(depth))
    if over.size:
        at = int(over[0])
        yield (
            f"{options.force_model} predicts {force[at]:.2f} N at a depth of {depth[at]:.0f} mm, where the shaft "
            f"buckles at {float(shaft.buckling_n(depth[at])):.2f} N: shorten the unsupported length by a guide"
        )
