"""The next motion without a named effect: it explores the axis of a gap, or lowers detection limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.diagnosis import Diagnosis, GapAxis, Gates, Library, Verdict, diagnose
from needleplan.diagnosis.next_motion import Exploring, NextMotion, Revealing, next_motion
from needleplan.diagnosis.next_motion._explore import information_bits
from needleplan.models import simulate
from needleplan.models.effects import effect_named
from needleplan.reports.diagnosis.motion_file import motion_text, next_motion_document
from needleplan.signals import Array, Record, Role
from needleplan.simulation import Experiment, run_experiment
from tests.diagnosis.trials import BASE, coloured, recordings

LIBRARY = Library([effect_named(name) for name in ("bias", "drift", "viscous", "inertia")], BASE)
HIDES = Gates(relevant=0.001)
"""By which everything matters."""


def crosstalk(record: Record) -> Record:
    """What no library has: a reading that rises with the square of the speed, either way."""
    if record.role is Role.NOISE:
        return record
    return record.with_column("force_n", record["force_n"] + 0.03 * (record["velocity_mm_s"] / 5) ** 2)


@pytest.fixture(scope="module")
def nameless() -> Diagnosis:
    found = diagnose(BASE, [crosstalk(each) for each in recordings(seed=4)], library=LIBRARY)
    assert found.verdict is Verdict.UNKNOWN
    return found


@pytest.fixture(scope="module")
def quiet() -> Diagnosis:
    found = diagnose(BASE, recordings(), library=LIBRARY, gates=HIDES)
    assert found.verdict is Verdict.UNDERPOWERED
    return found


@pytest.mark.slow
def test_an_unexplained_gap_is_explored_along_its_axis(nameless: Diagnosis) -> None:
    proposed = next_motion(nameless)
    assert isinstance(proposed, Exploring)
    assert proposed.axis is nameless.decision.axis is GapAxis.SPEED
    assert proposed.bits == max(bits for _, bits in proposed.considered)
    assert dict(proposed.considered)["constant_slow"] < proposed.bits
    assert proposed.reach[0] < 1 < proposed.reach[1]
    assert "speed" in proposed.why


@pytest.mark.slow
def test_predicted_detection_limits_are_those_after_the_motion(quiet: Diagnosis) -> None:
    """Slow twin: the motion made, and everything diagnosed again."""
    proposed = next_motion(quiet)
    assert isinstance(proposed, Revealing)
    force = simulate(BASE, proposed.motion).output + coloured(np.random.default_rng(1), len(proposed.motion))
    names = ("time_s", "depth_mm", "velocity_mm_s")
    columns = {name: getattr(proposed.motion, name) for name in names} | {"force_n": force}
    again = diagnose(BASE, [Record(columns, "more"), *recordings()], library=LIBRARY, gates=HIDES)
    seen = {each.effect: each.amplitude for each in again.detection_limits}
    for each in proposed.effects:
        assert each.after == pytest.approx(seen[each.effect], rel=0.1)
        assert each.now is not None
        assert each.now > each.after
    assert proposed.shrinks_to == min(share for _, share in proposed.considered) <= proposed.repeated_shrinks_to


@pytest.mark.slow
@pytest.mark.parametrize("which", ["nameless", "quiet"])
def test_their_files_run_in_the_lab_twin(which: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    found = request.getfixturevalue(which)
    proposed = next_motion(found)
    assert isinstance(proposed, NextMotion)
    file = tmp_path / "next_motion.toml"
    file.write_text(motion_text(proposed.program, proposed.why, proposed.role, found.base))
    done = run_experiment(Experiment.read(file)).record()
    assert done["depth_mm"].max() == pytest.approx(proposed.motion.depth_mm.max(), abs=0.1)
    assert next_motion_document(proposed)["why"] == proposed.why


def test_no_motion_is_proposed_without_an_open_question(quiet: Diagnosis) -> None:
    assert next_motion(replace(quiet, decision=replace(quiet.decision, verdict=Verdict.NONE))) is None


def squares(seed: int) -> list[Array]:
    generator = np.random.default_rng(seed)
    roots = [generator.standard_normal((3, 5)) for _ in range(3)]
    return [root.T @ root for root in roots]


@given(st.integers(0, 2**32), st.floats(0.01, 30))
def test_information_adds_up_and_is_less_the_more_is_known(seed: int, size: float) -> None:
    now, first, second = squares(seed)
    both = information_bits(now, first + second, size)
    assert both == pytest.approx(
        information_bits(now, first, size) + information_bits(now + first, second, size), abs=1e-9
    )
    assert information_bits(now + second, first, size) <= information_bits(now, first, size) + 1e-9
