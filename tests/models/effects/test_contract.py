"""What holds for every effect; a plug-in that is installed is tested with the others."""

from dataclasses import replace

import numpy as np
import pytest

from needleplan.errors import ModelError
from needleplan.models import Channel, Estimate, Model, ModelFile, Scale, ShaftAndTip, SpatialBicycle, simulate
from needleplan.models._simulate import _kutta
from needleplan.models.effects import (
    SIZE,
    AddedEffect,
    AugmentedModel,
    Effect,
    Enters,
    Reach,
    TermEffect,
    WithTerm,
    effect_named,
    known_effects,
    with_effect,
)
from needleplan.signals import Motion, lspb

BASE = ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.4)
BASES: dict[Channel, Model] = {Channel.FORCE: BASE, Channel.TIP: SpatialBicycle(curvature_per_mm=1 / 200)}
EFFECTS = sorted(known_effects().values(), key=lambda each: each.name)


def path(rate_hz: float = 50.0) -> Motion:
    motion = lspb([0, 20, 14, 35, 0], [8, 5, 6, 10], dwells_s=[1, 0, 1, 0], rate_hz=rate_hz)
    return replace(motion, angle_rad=np.clip(motion.time_s - 4, 0, 1.5))


def values_of(effect: Effect) -> dict[str, float]:
    grid = effect.grid(Reach.of([path()]))
    return {SIZE: effect.parameters[SIZE].typical, **grid[len(grid) // 2]}


def base(effect: Effect) -> Model:
    return BASES[effect.channel]


@pytest.fixture(params=EFFECTS, ids=lambda each: each.name)
def effect(request: pytest.FixtureRequest) -> Effect:
    found: Effect = request.param
    return found


def test_it_says_what_it_is(effect: Effect) -> None:
    for text in (effect.title, effect.equation, effect.meaning, effect.source):
        assert text.strip()
    size = effect.parameters[SIZE]
    assert size.scale is Scale.LINEAR
    assert size.lower <= 0 <= size.upper
    for values in effect.grid(Reach.of([path()])):
        assert values.keys() | {SIZE} == effect.parameters.keys()
        assert all(effect.parameters[key].lower <= each <= effect.parameters[key].upper for key, each in values.items())


def test_size_zero_is_the_base_to_the_last_bit(effect: Effect) -> None:
    values = {**values_of(effect), SIZE: 0.0}
    for model in (effect.apply(base(effect), values), with_effect(base(effect), AddedEffect(effect.name, values))):
        assert simulate(model, path()).output.tobytes() == simulate(base(effect), path()).output.tobytes()


def test_columns_are_what_the_simulation_gains(effect: Effect) -> None:
    values = values_of(effect)
    size = values[SIZE]
    gained = simulate(effect.apply(base(effect), values), path()).output - simulate(base(effect), path()).output
    column = effect.columns(base(effect), path(), [{key: each for key, each in values.items() if key != SIZE} | (
        {SIZE: size} if any(SIZE in each for each in effect.grid(Reach.of([path()]))) else {}
    )])[:, 0]  # fmt: skip
    scale = np.abs(gained).max()
    assert scale > 0
    np.testing.assert_allclose(size * column, gained.ravel(), atol=0.06 * scale)


@pytest.mark.slow
def test_memories_are_their_rates_integrated(effect: Effect) -> None:
    if not isinstance(effect, TermEffect):
        pytest.skip("has no memory of its own")
    model = effect.apply(base(effect), values_of(effect))
    assert isinstance(model, WithTerm)
    fine = path(400.0)
    start = model.initial_state(fine)
    states = _kutta(model, fine, start, 1)
    slow, fast = model.output(states, fine), simulate(model, fine).output
    np.testing.assert_allclose(slow, fast, atol=0.03 * np.abs(fast).max())


def test_a_run_goes_on_where_it_was(effect: Effect) -> None:
    model, motion = effect.apply(base(effect), values_of(effect)), path()
    whole = simulate(model, motion)
    rest = simulate(model, motion[200:], whole.states[:, 200])
    np.testing.assert_allclose(rest.output, whole.output[..., 200:], atol=1e-9)


def test_a_model_file_keeps_it(effect: Effect) -> None:
    values = values_of(effect)
    size = values[SIZE]
    estimate = {SIZE: Estimate(size, 0.1, size - 0.2, size + 0.2, effect.parameters[SIZE].unit, True)}
    model = with_effect(base(effect), AddedEffect(effect.name, values, estimate, "sha256:0"))
    again = ModelFile.from_toml(ModelFile(model).to_toml())
    assert again.model == model
    np.testing.assert_array_equal(simulate(again.model, path()).output, simulate(model, path()).output)


def test_what_is_of_the_sensor_is_not_in_the_plant(effect: Effect) -> None:
    model = with_effect(base(effect), AddedEffect(effect.name, values_of(effect)))
    assert (model.plant is base(effect)) == (effect.enters is Enters.SENSOR)


def test_a_model_with_two_effects_adds_both() -> None:
    first, second = AddedEffect("bias", {SIZE: 0.1}), AddedEffect("viscous", {SIZE: 1e-4})
    both = with_effect(with_effect(BASE, first), second)
    assert isinstance(both, AugmentedModel)
    assert both.values()["bias.size"] == 0.1
    alone = [simulate(with_effect(BASE, each), path()).output for each in (first, second)]
    plain = simulate(BASE, path()).output
    np.testing.assert_allclose(simulate(both, path()).output - plain, sum(alone) - 2 * plain, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [
        ("puncure", {SIZE: 1.0}, 'did you mean "puncture"'),
        ("bias", {}, "is missing"),
        ("bias", {SIZE: 1.0, "depth_mm": 3.0}, "is not a parameter of bias"),
        ("viscous", {SIZE: 5.0}, "must be from -0.01 to 0.01 N s/mm2"),
    ],
)
def test_what_is_wrong_is_said(name: str, values: dict[str, float], says: str) -> None:
    with pytest.raises(ModelError, match=says):
        AddedEffect(name, values)


def test_an_effect_of_another_name_has_a_suggestion() -> None:
    assert effect_named("bias").title
    with pytest.raises(ModelError, match="must be one of"):
        effect_named("nothing like it")


def test_it_can_be_added_beside_every_other(effect: Effect) -> None:
    """A diagnosis takes one after the other, in any order."""
    motion = path()
    plain = simulate(base(effect), motion).output
    for other in EFFECTS:
        if other.channel is not effect.channel or (other is effect and not effect.repeats):
            continue
        both = other.apply(effect.apply(base(effect), values_of(effect)), values_of(other))
        output = simulate(both, motion).output
        assert output.shape == plain.shape
        assert np.isfinite(output).all(), other.name
