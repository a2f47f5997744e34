import json

import numpy as np
import pytest

from needleplan.diagnosis import Library, Verdict, diagnose
from needleplan.errors import DataError
from needleplan.models import Channel, ModelFile, SpatialBeam, SpatialBicycle, simulate
from needleplan.models.effects import AugmentedModel, effect_named, effects_of
from needleplan.models.path import path_displacement
from needleplan.reports.diagnosis import document_of, traces_of
from needleplan.signals import fit_axes
from tests.diagnosis.tip_trials import BASE, NOISE_MM, motion, recordings

NAMES = ("curvature_speed", "torsional_lag", "pre_bend", "misalignment", "tracker_bias", "entry_rupture")
LIBRARY = Library([effect_named(name) for name in NAMES], BASE)


def test_axes_of_a_tracker_share_a_colour_and_have_their_own_strength() -> None:
    generator = np.random.default_rng(2)
    sizes = np.array([0.1, 0.2, 0.4])
    rows = [[size * generator.standard_normal(4000)] for size in sizes]
    noise = fit_axes(rows)
    new = noise.whiten(np.concatenate([row[0] for row in rows]))
    assert new.std() == pytest.approx(1.0, rel=0.03)
    parts = np.split(new, 3)
    np.testing.assert_allclose([part.std() for part in parts], 1.0, rtol=0.05)


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_missing() -> None:
    found = diagnose(BASE, recordings(seed=1), library=LIBRARY)
    assert found.verdict in (Verdict.NONE, Verdict.UNDERPOWERED)
    assert found.calibration.noise.rms == pytest.approx(NOISE_MM, rel=0.1)


@pytest.mark.slow
@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "values", "of_the_sensor"),
    [
        ("torsional_lag", {"size": 0.012}, False),
        pytest.param("tracker_bias", {"size": 0.8, "direction_rad": 1.0}, True, marks=pytest.mark.slow),
    ],
)
def test_an_effect_is_named_measured_and_added(name: str, values: dict[str, float], *, of_the_sensor: bool) -> None:
    found = diagnose(BASE, recordings({name: values}, seed=3), library=LIBRARY)
    assert (found.verdict, found.names) == (Verdict.NAMED, (name,))
    size = found.effects[0].estimates["size"]
    assert abs(size.value) == pytest.approx(values["size"], abs=5 * size.sd)
    assert found.shrink > 0.8
    model = found.model
    assert isinstance(model, AugmentedModel)
    assert (model.plant is model.base) == of_the_sensor
    again = ModelFile.from_toml(ModelFile(model).to_toml()).model
    np.testing.assert_array_equal(simulate(again, motion(0)).output, simulate(model, motion(0)).output)
    document = json.loads(json.dumps(document_of(found, traces_of(found), None), allow_nan=False))
    assert (document["channel"], document["unit"]) == ("tip_mm", "mm")


@pytest.mark.study
@pytest.mark.parametrize(
    ("radius_mm", "hidden"),
    [
        # three other effects promise more beside the base that gravity distorts
        (141.0, {"gravity": {"size": 0.0025, "fading_mm": 2000.0}}),
        # a layer imitates the rupture: beside the base of the layer alone, nothing is left for it
        (54.0, {"entry_rupture": {"size": 0.22, "length_mm": 16.0}, "gravity": {"size": -0.00087, "fading_mm": 60.0}}),
    ],
    ids=lambda each: "+".join(each) if isinstance(each, dict) else None,
)
def test_effects_are_named_that_promise_less_than_others(radius_mm: float, hidden: dict[str, dict[str, float]]) -> None:
    base = SpatialBicycle(1 / radius_mm)
    found = diagnose(base, recordings(hidden, seed=2, base=base), library=Library(effects_of(Channel.TIP), base))
    assert (found.verdict, set(found.names)) == (Verdict.NAMED, set(hidden))


def test_a_gap_without_a_name_that_distorts_the_base_keeps_the_given_one() -> None:
    data = recordings({"gravity": {"size": 0.0016, "fading_mm": 150.0}}, seed=1)
    found = diagnose(BASE, data, library=LIBRARY)  # in which gravity is not
    assert (found.verdict, found.keeps_given, found.model) == (Verdict.UNKNOWN, True, BASE)
    (held_out,) = found.checked.held_out
    tip = np.concatenate([held_out[name] for name in ("x_mm", "y_mm", "z_mm")])
    apart = {each: tip - simulate(each, held_out.motion()).output.ravel() for each in (found.given, found.base)}
    given, base = (float(np.sqrt(np.mean(each**2))) for each in apart.values())
    assert (found.held_out_rms(found.given), found.held_out_rms(found.base)) == pytest.approx((given, base))
    assert found.remarks[-1] == (
        f"the calibrated base predicts the held-out trials worse (RMS {base:.3g} mm) than the given base "
        f"({given:.3g} mm), which is kept: what has no name distorts it"
    )


@pytest.mark.slow
def test_a_gap_without_a_name_keeps_a_calibrated_base_that_predicts_better() -> None:
    bent = BASE.with_values(curvature_per_mm=1.6 * BASE.curvature_per_mm)
    found = diagnose(
        BASE, recordings({"gravity": {"size": 0.0004, "fading_mm": 150.0}}, seed=1, base=bent), library=LIBRARY
    )
    assert (found.verdict, found.keeps_given, found.model) == (Verdict.UNKNOWN, False, found.base)
    assert found.held_out_rms(found.base) < found.held_out_rms(found.given) / 5
    assert not any("kept" in each for each in found.remarks)


@pytest.mark.parametrize("base", [BASE, SpatialBeam(1 / 200, felt_mm=40.0)], ids=lambda each: each.name)
def test_modes_and_simulation_move_the_tip_alike(base: SpatialBicycle) -> None:
    path = motion(0)
    more = 1e-6
    plain = simulate(base, path)
    moved = simulate(base.with_values(curvature_per_mm=base.curvature_per_mm + more), path).output - plain.output
    states = plain.states
    direction = np.cos(states[9]) * states[6:9] + np.sin(states[9]) * np.cross(states[3:6], states[6:9], axis=0)
    bend = np.hypot(*base.bend_per_mm(path, states[9]))[:, None] / base.curvature_per_mm
    linear = path_displacement(states, path, more * bend, direction, getattr(base, "felt_mm", 0.0))[:, 0]
    aside = slice(len(path), None)  # along the path a beam that turns as a whole is left out
    np.testing.assert_allclose(linear[aside], moved.ravel()[aside], atol=0.02 * np.abs(moved).max())


@pytest.mark.slow
def test_a_beam_is_a_base_too() -> None:
    beam = SpatialBeam(1 / 200)
    library = Library([effect_named(name) for name in ("curvature_layer", "entry_rupture", "coil_offset")], beam)
    data = recordings({"curvature_layer": {"size": 0.5, "depth_mm": 30.0}}, seed=3, base=beam)
    found = diagnose(beam, data, library=library)
    assert (found.verdict, found.names) == (Verdict.NAMED, ("curvature_layer",))
    estimates = found.effects[0].estimates
    assert estimates["size"].low < 0.5 < estimates["size"].high
    assert estimates["depth_mm"].value == pytest.approx(30.0, abs=0.2)


def test_every_axis_is_needed() -> None:
    data = recordings()
    data[0].columns.pop("z_mm")
    with pytest.raises(DataError, match="z_mm"):
        diagnose(BASE, data, library=LIBRARY)
