"""Where in its interval a reading is taken is not known: a common delay below half an interval is no effect."""

from __future__ import annotations

import numpy as np
import pytest

from needleplan.diagnosis import Library, diagnose
from needleplan.diagnosis._diagnose import _best_sampling
from needleplan.diagnosis._hypothesis import nuisances
from needleplan.diagnosis._settings import Settings
from needleplan.models import simulate
from needleplan.models.effects import effect_named
from needleplan.signals import Record, Role, lspb
from tests.diagnosis.trials import BASE

SLOW = BASE.with_values(presliding_mm=0.25)
PROGRAMS = (
    (Role.TRAIN, [-2, 31, 20, 60, 48, 60, -2], [4, 8, 6, 12, 5, 9]),
    (Role.TRAIN, [-2, 45, 35, 60, 40, -2], [9, 5, 3, 10, 7]),
    (Role.HOLDOUT, [-2, 20, 10, 60, -2], [10, 4, 8, 6]),
)


def late(delay_s: float, rate_hz: float = 50.0, noise_n: float = 0.013, seed: int = 3) -> list[Record]:
    """Return recordings whose readings are taken so much later than their time says, each the mean over an interval."""
    random, found = np.random.default_rng(seed), []
    for number, (role, depths, speeds) in enumerate(PROGRAMS):
        fine = lspb(depths, speeds, rate_hz=40 * rate_hz)
        force = simulate(SLOW, fine).output
        force = np.interp(fine.time_s - delay_s, fine.time_s, force)
        motion = lspb(depths, speeds, rate_hz=rate_hz)
        edges = np.interp(
            np.append(motion.time_s - 0.5 / rate_hz, motion.time_s[-1] + 0.5 / rate_hz), fine.time_s,
            np.concatenate([[0.0], np.cumsum((force[1:] + force[:-1]) / 2 * np.diff(fine.time_s))]),
        )  # fmt: skip
        widths = np.full(len(motion), 1 / rate_hz)
        widths[[0, -1]] /= 2
        read = np.diff(edges) / widths + random.normal(0, noise_n, len(motion))
        columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
        found.append(Record({**columns, "force_n": read}, f"trial {number}", role))
    still = {"time_s": np.arange(1500) / rate_hz, "force_n": random.normal(0, noise_n, 1500)}
    return [*found, Record(still, "air", Role.NOISE)]


def test_the_column_is_the_change_of_the_readings_by_a_delay() -> None:
    _, empty = _best_sampling(SLOW, late(0.0), Settings())
    trial = empty.trials[0]
    own = 0.02 / np.sqrt(12)
    delayed = effect_named("latency").apply(trial.model, {"size": own})
    change = simulate(delayed, trial.motion).output - simulate(trial.model, trial.motion).output
    column = nuisances(empty.problem, trial, 0, ())[:, -1]
    assert column == pytest.approx(empty.problem.whiten(trial, 0, change), abs=0.02 * np.abs(column).max())


@pytest.mark.slow
@pytest.mark.parametrize("delay_s", [0.009, -0.006])
def test_a_delay_within_the_interval_is_no_play_of_the_drive(delay_s: float) -> None:
    found = diagnose(SLOW, late(delay_s))
    assert found.names == ()
    assert max(abs(trial.lag_s) for trial in found.nothing.trials) < 0.009


def test_a_delay_far_above_the_interval_is_named_and_its_interval_holds_it() -> None:
    few = Library([effect_named(name) for name in ("latency", "backlash", "bias")], SLOW)
    found = diagnose(SLOW, late(0.06), library=few)
    assert found.names == ("latency",)
    size = found.effects[0].estimates["size"]
    assert size.low < 0.06 < size.high
