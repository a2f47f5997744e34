"""Large effects in readings of a quiet sensor: base and laws without the effect are far from those with it."""

import numpy as np
import pytest

from needleplan.diagnosis import Library, Verdict, diagnose
from needleplan.diagnosis._evidence import Columns
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.diagnosis._screening import Child, Screening
from needleplan.models import simulate
from needleplan.models.effects import effect_named
from needleplan.signals import Record, Role, lspb
from tests.diagnosis.trials import BASE

NOISE_N = 0.001
PROGRAMS = (
    (Role.TRAIN, [-2, 31, 20, 60, -2], [4, 8, 6, 12]),
    (Role.TRAIN, [-2, 45, 35, 60, -2], [9, 5, 3, 10]),
    (Role.HOLDOUT, [-2, 20, 60, -2], [10, 4, 8]),
)


def recordings(
    name: str, values: dict[str, float], rate_hz: float, seed: int, noise_n: float = NOISE_N
) -> list[Record]:
    random = np.random.default_rng(seed)
    model, found = effect_named(name).apply(BASE, values), []
    for number, (role, depths, speeds) in enumerate(PROGRAMS):
        motion = lspb(depths, speeds, rate_hz=rate_hz)
        force = simulate(model, motion).output + random.normal(0, noise_n, len(motion))
        columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
        found.append(Record({**columns, "force_n": force}, f"trial {number}", role))
    time = np.arange(int(20 * rate_hz)) / rate_hz
    still = {"time_s": time, "force_n": random.normal(0, noise_n, len(time))}
    return [*found, Record(still, "air", Role.NOISE)]


@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "values"),
    [("backlash", {"size": 0.1}), ("puncture", {"size": 1.0, "depth_mm": 33.333, "bulge_mm": 3.0})],
)
def test_a_large_effect_is_named_alone_and_measured(name: str, values: dict[str, float]) -> None:
    found = diagnose(BASE, recordings(name, values, rate_hz=400.0, seed=0))
    assert (found.verdict, found.names) == (Verdict.NAMED, (name,))
    for key, each in found.effects[0].estimates.items():
        assert each.low < values[key] < each.high
    size = found.effects[0].estimates["size"]
    assert size.high - size.low < 0.05 * values["size"]


@pytest.mark.slow
def test_beside_the_given_base_a_bias_is_screened_that_distorts_the_calibrated_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without the bias, friction, laws and lag are so far off that its column explains little beside them."""
    seen: dict[bool, float] = {}
    screened = Screening._screened

    def noted(self: Screening, parent: Hypothesis, columns: Columns, *, held: bool = False) -> list[Child]:
        children = screened(self, parent, columns, held=held)
        if not parent.effects and True not in seen:  # the given base comes last; later, effects are exchanged
            (bias,) = [each for each in children if each.starts and each.starts[0].name == "bias"]
            seen[held] = max(seen.get(held, -np.inf), bias.score)
        return children

    monkeypatch.setattr(Screening, "_screened", noted)
    few = Library([effect_named(each) for each in ("bias", "viscous")], BASE)
    found = diagnose(BASE, recordings("bias", {"size": 0.1}, rate_hz=50.0, seed=1), library=few)
    assert found.names == ("bias",)
    best = found.posterior.hypotheses["bias",].log_evidence
    assert abs(seen[True] - best) < 0.1 * abs(seen[False] - best)


@pytest.mark.study
def test_an_effect_that_is_found_beside_a_false_one_is_fitted_alone_from_the_same_point() -> None:
    """The layer is found first, and the puncture beside it; then the layer has next to no amplitude."""
    truth = {"size": 1.0, "depth_mm": 33.333, "bulge_mm": 3.0}
    few = Library([effect_named(each) for each in ("cutting_layer", "puncture")], BASE)
    found = diagnose(BASE, recordings("puncture", truth, rate_hz=50.0, seed=0, noise_n=0.01), library=few)
    assert ("cutting_layer", "puncture") in found.posterior.hypotheses
    assert found.names == ("puncture",)
    for key, each in found.effects[0].estimates.items():
        assert each.low < truth[key] < each.high
