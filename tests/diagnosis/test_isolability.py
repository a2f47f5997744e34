import numpy as np
import pytest

from needleplan.diagnosis import Isolability, Library, isolability
from needleplan.diagnosis.calibration import CalibratedTrial, Calibration, calibrate
from needleplan.models import simulate
from needleplan.models.effects import effect_named
from needleplan.signals import Array, Record, Role, fit_noise, lspb
from tests.diagnosis.trials import BASE, coloured, recordings

NAMES = ("viscous", "bias", "drift", "inertia", "gain_error")
LIBRARY = Library([effect_named(name) for name in NAMES], BASE)


def matrix(records: list[Record], heterogeneity_sd: float = 0.0) -> Isolability:
    noise = fit_noise([each["force_n"] for each in records if each.role is Role.NOISE])
    training = [each for each in records if each.role is Role.TRAIN]
    return isolability(calibrate(BASE, training, [], noise), LIBRARY, heterogeneity_sd)


def one_speed() -> list[Record]:
    random = np.random.default_rng(3)
    path = lspb([-2, 60, -2], [5, 5], rate_hz=50)
    columns = {"time_s": path.time_s, "depth_mm": path.depth_mm, "velocity_mm_s": path.velocity_mm_s}

    force = simulate(BASE, path).output
    trials = [Record({**columns, "force_n": force + coloured(random, len(path))}, f"{i}", Role.TRAIN) for i in range(2)]
    return [*trials, *(each for each in recordings() if each.role is Role.NOISE)]


@pytest.fixture(scope="module")
def rich() -> Isolability:
    return matrix(recordings())


def test_shares_are_shares(rich: Isolability) -> None:
    known = rich.imitated[np.isfinite(rich.imitated)]
    assert rich.effects == NAMES
    assert ((known >= 0) & (known <= 1)).all()
    assert (np.diag(rich.imitated)[np.isfinite(np.diag(rich.imitated))] == 1).all()


def test_one_speed_tells_less_than_many(rich: Isolability) -> None:
    poor = matrix(one_speed())
    bias, drift = NAMES.index("bias"), NAMES.index("drift")
    assert poor.imitated[bias, drift] > rich.imitated[bias, drift]


def two_effects() -> tuple[Calibration, Library, list[tuple[CalibratedTrial, Array]]]:
    """Return a calibration, a library of two effects with one place each, and trials with their whitened columns."""
    records = recordings()
    noise = fit_noise([each["force_n"] for each in records if each.role is Role.NOISE])
    found = calibrate(BASE, [each for each in records if each.role is Role.TRAIN], [], noise)
    library = Library([effect_named("viscous"), effect_named("bias")], BASE)
    entries = library.entries([trial.motion for trial in found.training])
    return found, library, [
        (trial, trial.whiten(library.sensitivities(found.model, trial.motion, entries)))
        for trial in found.training
    ]  # fmt: skip


def test_with_one_place_each_it_is_the_square_of_a_correlation() -> None:
    """The obvious way: regress one column on all that the base can do, and correlate what is left."""
    found, library, trials = two_effects()
    left = []
    for trial, columns in trials:
        base = trial.whitened.base
        left.append(columns - base @ np.linalg.lstsq(base, columns, rcond=None)[0])
    a, b = np.vstack(left).T
    expected = (a @ b) ** 2 / ((a @ a) * (b @ b))
    assert isolability(found, library, 0.0).imitated[0, 1] == pytest.approx(expected, rel=1e-6)


def test_what_heterogeneous_tissue_hides_depends_on_its_kind() -> None:
    """The slow way is generalised least squares with the whole covariance of each kind."""
    found, library, trials = two_effects()
    shares = []
    for kind in (0, 1):
        products = np.zeros((2, 2))
        for trial, columns in trials:
            tissue = 0.1 * trial.tissue[kind]
            covariance = np.eye(len(tissue)) + tissue @ tissue.T
            both = np.hstack([trial.whitened.base, columns])
            inner = both.T @ np.linalg.solve(covariance, both)
            q = trial.whitened.base.shape[1]
            products += inner[q:, q:] - inner[q:, :q] @ np.linalg.solve(inner[:q, :q], inner[:q, q:])
        shares.append(products[0, 1] ** 2 / (products[0, 0] * products[1, 1]))
        assert isolability(found, library, 0.1, smooth=kind == 1).imitated[0, 1] == pytest.approx(shares[-1], rel=1e-4)
    assert shares[0] != pytest.approx(shares[1], rel=1e-2)


def test_pairs_are_listed_from_a_share_on() -> None:
    three = Isolability(("a", "b", "c"), np.array([[1, 0.9, 0.1], [0.85, 1, np.nan], [0.0, 0.0, 1]]))
    assert three.alike() == (("a", "b", 0.9), ("b", "a", 0.85))
