"""`entry` and `plan` in 3D where no entry reaches the target: one sentence on standard error, and exit code 1."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from needleplan.anatomy import FREE, TARGET, write_phantom
from needleplan.planning import Success, rank_entries, unreached
from tests.anatomy.volumes import TEXT, anatomy, box, write
from tests.cli.commands import needleplan


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", [pytest.param("prostate", marks=pytest.mark.study), "brain"]
)  # in the others, this cone leaves a way or none that is tried
def test_a_cone_that_is_too_narrow_is_told(kind: str, tmp_path: Path) -> None:
    scene = write_phantom(kind, tmp_path, 5)
    text = scene.read_text()
    # Directions so near that the table still sees ways through the cone.
    for key, value in (("cone_deg", 5.0), ("directions_deg", 3.29)):
        text, count = re.subn(rf"(?m)^{key} = [\d.]+", f"{key} = {value}", text)
        assert count == 1
    scene.write_text(text)
    done = needleplan("entry", scene, "--json")
    assert done.returncode == 1
    found = json.loads(done.stdout)
    assert found["answer"] == "not decided"
    highest = found["unreached"]["highest"]
    assert max(each["success_interval"][1] for each in found["entries"]) <= highest < 0.01
    assert found["unreached"]["ended"]["cone"] > 0.9
    sentence = f"no entry reaches the target in more than {100 * highest:.1f} % of executions"
    planned = needleplan("plan", scene)
    assert planned.returncode == 1
    for said in (done.stderr, planned.stderr):
        (line,) = [each for each in said.splitlines() if each.startswith("needleplan: not found")]
        assert sentence in line
        assert "leave the cone of 5 degrees, so that a wider one may help (lattice.cone_deg)" in line


@pytest.mark.slow
def test_an_entry_that_may_reach_the_target_is_not_hopeless(tmp_path: Path) -> None:
    assert unreached(rank_entries(anatomy(box()), threads=1)) is None
    scene = write(tmp_path, box())
    assert json.loads(needleplan("entry", scene, "--json").stdout)["unreached"] is None
    assert needleplan("plan", scene).returncode == 0


def test_an_interval_that_reaches_one_percent_is_not_hopeless(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = rank_entries(anatomy(box()), threads=1)
    for highest, is_hopeless in ((0.0099, True), (0.01, False)):
        estimate = Success(0.001, (0.0, highest), "executions", 2000)
        monkeypatch.setattr(type(entries), "estimate", lambda *_, found=estimate: found)
        found = unreached(entries)
        assert (found is not None) == is_hopeless
        if found:
            assert str(found).startswith(
                "not found with these settings: no entry reaches the target in more than 1.0 % of executions, as far as"
            )


@pytest.mark.slow
def test_where_the_policy_gives_up_all_settings_are_named(tmp_path: Path) -> None:
    found = unreached(rank_entries(anatomy(box(wall=True)), threads=1))
    assert found is not None
    assert found.ended == {}  # the needle would leave the cone, because that is the shortest way to fail
    for setting in ("the cone of 24 degrees", "curvature of 60 mm", "margin of 0 mm", "needle.tip_noise_deg"):
        assert setting in str(found)
    done = needleplan("plan", write(tmp_path, box(wall=True)))
    assert done.returncode == 1
    assert "impossible: no path leads from the entry region" in done.stderr


def test_every_execution_has_an_end() -> None:
    noisy = TEXT.replace("radius_mm = 60.0", "radius_mm = 60.0\ntip_noise_deg = 20.0")
    entries = rank_entries(anatomy(box(), noisy), threads=1)
    found = entries.table.executions(entries.poses[0], 100)
    assert np.array_equal(found.reached, found.ends == TARGET)
    assert FREE in found.ends  # left the cone
