"""A law of the base that differs is added to the corrected model as curves."""

from types import SimpleNamespace

import numpy as np
import pytest

from needleplan.diagnosis import FindingKind, Verdict, default_library, diagnose
from needleplan.diagnosis._base_law import LAW_COUNTS, base_laws, full_cutting, law_curves
from needleplan.diagnosis._settings import Settings
from needleplan.models import ModelFile, ShaftAndTip, simulate
from needleplan.models.effects import Reach
from needleplan.signals import Record, Role, lspb
from tests.diagnosis.trials import NOISE_N, RATE_HZ, coloured, motion

BASE = ShaftAndTip(friction=0.03, cutting=2.0, onset_mm=4.0, presliding_mm=0.2)
NEW = lspb([-2, 33, 25, 62, -2], [6, 9, 3, 12], dwells_s=[1, 0, 1, 0], rate_hz=RATE_HZ)


def true_force(model, path):
    """Return the force with a cutting force that grows as 1 - exp(-(L / onset)^2), not as that of the base."""
    bristle, depth = simulate(model, path).states[0], np.maximum(path.depth_mm, 0.0)
    grown = 1 - np.exp(-((depth / model.onset_mm) ** 2))
    return model.friction * depth * bristle + model.cutting * grown * (1 + bristle) / 2


def records():
    generator, found = np.random.default_rng(3), []
    for number, role in enumerate((Role.TRAIN, Role.TRAIN, Role.HOLDOUT)):
        path, scale = motion(number), generator.uniform(0.995, 1.005, 2)
        model = BASE.with_values(friction=scale[0] * BASE.friction, cutting=scale[1] * BASE.cutting)
        force = true_force(model, path) + coloured(generator, len(path))
        columns = {"time_s": path.time_s, "depth_mm": path.depth_mm, "velocity_mm_s": path.velocity_mm_s}
        found.append(Record({**columns, "force_n": force}, f"trial {number}", role))
    still = {"time_s": np.arange(1500) / RATE_HZ, "depth_mm": np.full(1500, -5.0), "force_n": coloured(generator, 1500)}
    return [*found, Record(still, "noise", Role.NOISE)]


def test_the_curves_are_the_functions_of_the_tolerance():
    path, settings = motion(0), Settings()
    reach, largest, generator = Reach.of([path]), 2.0, np.random.default_rng(1)
    given = {law: generator.standard_normal(count) for law, count in LAW_COUNTS.items()}
    trial = SimpleNamespace(model=BASE, motion=path, measured=np.zeros(len(path)))
    wanted = base_laws(trial, (), reach, largest, settings) @ np.concatenate([*given.values()])
    state = simulate(BASE, path).states
    shaft, tip = BASE.shaft_n(state, path), BASE.tip_n(state, path)
    curves = law_curves(BASE, given, reach, largest, settings)
    found = sum(curves.changed(shaft, tip, full_cutting(BASE, path), path)) - shaft - tip
    assert np.abs(wanted).max() > 0.1
    np.testing.assert_allclose(found, wanted, atol=0.05 * np.abs(wanted).max())


@pytest.mark.slow
def test_the_corrected_model_has_the_law_and_predicts_a_new_motion(tmp_path):
    found = diagnose(BASE, records(), library=default_library(BASE))
    assert found.verdict is Verdict.CHANGED
    assert FindingKind.LAW in {finding.kind for finding in found.findings}
    corrected = found.model
    assert isinstance(corrected, ShaftAndTip)
    assert corrected.curves is not None
    truth = true_force(BASE, NEW)
    before, after = (float(np.std(simulate(model, NEW).output - truth)) for model in (BASE, corrected))
    assert after < before / 3
    assert after < 2 * NOISE_N
    ModelFile.of(corrected).write(tmp_path / "model.toml")
    assert not found.keeps_given
    again = diagnose(tmp_path / "model.toml", records(), library=default_library(corrected))
    assert FindingKind.LAW not in {finding.kind for finding in again.findings}
    assert again.verdict in (Verdict.NONE, Verdict.UNDERPOWERED)
