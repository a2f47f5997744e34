import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.models import fit, ljung_box, residual_findings
from tests.models.line import Line, filtered, pushed


def p_values(noise: np.ndarray, seed: int = 0) -> dict[str, float | None]:
    record = pushed(np.random.default_rng(seed), noise, noise.size)
    return {each.name: each.p_value for each in residual_findings(fit(Line(0.02, 0.1), record), [record])}


def test_ljung_box_is_the_sum_in_its_paper() -> None:
    values = np.random.default_rng(0).standard_normal(100)
    centred = values - values.mean()
    rho = [sum(centred[i] * centred[i - k] for i in range(k, 100)) / sum(centred**2) for k in range(1, 6)]
    expected = 100 * 102 * sum(r**2 / (100 - k) for k, r in enumerate(rho, start=1))
    assert ljung_box([values], 5)[0] == pytest.approx(expected)
    assert ljung_box([values, values], 5)[0] == pytest.approx(2 * expected)


@pytest.mark.slow
@pytest.mark.parametrize("correlated", [False, True])
def test_noise_alone_is_found_guilty_as_often_as_it_should(correlated: bool) -> None:
    random, trials = np.random.default_rng(1), 80
    guilty = dict.fromkeys(p_values(np.ones(200)), 0)
    for _ in range(trials):
        noise = filtered(random, 400) if correlated else 0.05 * random.standard_normal(400)
        for name, p_value in p_values(noise).items():
            guilty[name] += p_value is not None and p_value < 0.05
    whiteness = guilty.pop("whiteness")
    assert whiteness > 0.9 * trials if correlated else whiteness < 0.15 * trials
    assert max(guilty.values()) < 0.15 * trials


@pytest.mark.parametrize("correlated", [False, True])
@pytest.mark.parametrize(
    ("name", "effect"),
    [
        ("dependence on direction", lambda record: 0.05 * np.sign(record["velocity_mm_s"])),
        ("trend with velocity", lambda record: 0.003 * record["velocity_mm_s"]),
        ("normality", lambda record: 0.6 * (np.arange(len(record)) % 37 == 0)),
    ],
)
def test_an_effect_is_found(name: str, effect: object, correlated: bool) -> None:
    random = np.random.default_rng(2)
    noise = filtered(random, 600, 0.5) if correlated else 0.05 * random.standard_normal(600)
    clean = pushed(random, np.zeros(600), 600)
    found = p_values(noise + effect(clean))  # type: ignore[operator]
    assert found[name] is not None
    assert found[name] < 1e-3


def test_a_wrong_offset_leaves_a_trend() -> None:
    random = np.random.default_rng(3)
    record = pushed(random, None, 800)
    found = fit(Line(0.02, 0.2), record, free=["slope"])
    depth = next(each for each in residual_findings(found, [record]) if each.name == "trend with depth")
    assert depth.p_value is not None
    assert depth.p_value < 1e-3
    assert "the residuals depend on the depth" in depth.says


def test_what_cannot_be_tested_says_why() -> None:
    record = pushed(np.random.default_rng(4)).select(slice(0, 15))
    findings = residual_findings(fit(Line(0.02, 0.1), record), [record])
    assert len(findings) == 6
    assert all(each.p_value is None and "fewer than 20 samples" in each.says for each in findings)
    with pytest.raises(DataError, match="must be the records of the fit"):
        residual_findings(fit(Line(0.02, 0.1), record), [record, record])
