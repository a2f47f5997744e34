"""Every public object has a repr in one line, below 200 characters."""

import copy
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import needleplan as npl
from needleplan.anatomy import Anatomy, SpaceScenario
from needleplan.artifacts import MOST_CHARACTERS, short_html, short_repr
from needleplan.diagnosis import Diagnosis
from needleplan.estimation.registration import Registration
from needleplan.identification import Identification
from needleplan.identification.force_library import ForceLibrary
from needleplan.models import Bicycle, ModelFile
from needleplan.page import DiagnosisFile
from needleplan.planning import edge_profile, entry_map
from needleplan.scenario import Target
from needleplan.signals import Motion, Record
from needleplan.simulation import Simulation
from tests.anatomy.volumes import box, write

pytestmark = pytest.mark.usefixtures("few_executions")


def named(folder: Path, table: npl.PolicyTable) -> dict[str, Any]:
    """Return public objects that are made in little time, by their names."""
    anatomy = Anatomy.read(write(folder, box()))
    space, entry = npl.plan(anatomy), table.best_entry()
    best, process = space.best_entry(), npl.mdp.TabularMdp([np.eye(100)] * 2, np.ones((100, 2)), discount=0.9)
    long = np.arange(1000.0)
    record = Record({"time_s": long, "depth_mm": long, "force_n": np.ones(1000)}, notes=("n" * 90,) * 9)
    library, simulation = ForceLibrary.read("published"), Simulation.read("insertion")
    entries = entry_map(space)
    return {
        "anatomy": anatomy, "anatomy file": anatomy.file, "3D scenario": SpaceScenario.of(anatomy),
        "grid": space.scenario.grid, "frame": space.scenario.grid.frame, "volume": anatomy.volume, "3D table": space,
        "3D pose": best, "3D decision": space.lookup(best), "success": space.estimate(best),
        "3D path": space.path(best),
        "entry map": entries, "3D entry": entries.entry(0, 0), "scenario": table.scenario, "table": table,
        "stats": table.stats, "entry": entry, "profile": edge_profile(table), "decision": table.lookup(entry),
        "decisions": table.lookup_many([entry.pose] * 500), "expectations": table.expectations(),
        "path": table.path(entry), "rollouts": table.rollout(entry, runs=50), "obstacle": table.scenario.obstacles[0],
        "record": record,
        "model": Bicycle(curvature_per_mm=0.01), "model file": ModelFile(Bicycle(curvature_per_mm=0.01)),
        "force library": library, "combination": library.combinations[0], "simulation": simulation,
        "setup": simulation.setup, "registration": Registration(), "process": process,
        "solution": npl.mdp.solve(process), "view": npl.view(table),
        "diagnosis file": DiagnosisFile({"text": "x" * 9999}, "folder"),
    }  # fmt: skip


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory, table: npl.PolicyTable) -> dict[str, Any]:
    return named(tmp_path_factory.mktemp("objects"), table)


@pytest.mark.slow
def test_reprs_are_short(objects: dict[str, Any]) -> None:
    texts = {name: (repr(each), str(each)) for name, each in objects.items()}
    wrong = [name for name, both in texts.items() if any(len(each) >= 200 or "\n" in each for each in both)]
    assert wrong == []
    assert all(type(each).__name__ in texts[name][0] for name, each in objects.items())


@pytest.mark.slow
def test_notebooks_show_html(objects: dict[str, Any]) -> None:
    without = [name for name, each in objects.items() if not hasattr(each, "_repr_html_")]
    assert without == []
    for name in ("record", "success", "registration", "model", "stats"):
        text = objects[name]._repr_html_()
        assert text.startswith(f"<table><caption>{type(objects[name]).__name__}</caption><tr><th>"), name
    assert "<img alt=" in objects["3D table"]._repr_html_()
    assert "<img alt=" in objects["3D path"]._repr_html_()
    assert "&lt;" in Sample("<script>")._repr_html_()


@pytest.mark.parametrize("kind", [Diagnosis, Identification, Simulation, npl.models.Fit, Registration], ids=str)
def test_answers_of_long_computations_take_the_short_repr(kind: type) -> None:
    assert kind.__repr__ is short_repr


def test_settings_models_and_motions_of_any_size_have_short_reprs() -> None:
    time = np.arange(1000.0)
    corners = tuple((float(number), float(number**2)) for number in range(40))
    fitted = npl.models.RelaxingForce()
    motion = Motion.sampled(time, time)
    for each in (npl.Obstacle(corners), ModelFile(fitted, remarks=("r" * 99,) * 9), fitted, motion):
        assert len(repr(each)) < MOST_CHARACTERS
        assert "\n" not in repr(each)
    target = Target((100.0, 50.0), 2.0)
    assert repr(target) == "Target(center_mm=(100.0, 50.0), radius_mm=2.0)"


@dataclass
class Sample:
    """Fields of every kind."""

    text: str = ""
    values: Any = None
    more: Any = None

    __repr__ = short_repr
    _repr_html_ = short_html


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (np.zeros((2, 3), np.float32), "float32 (2, 3)"),
        (np.float64(0.5), "0.5"),
        (1 / 3, "0.333333"),
        ((1, 2.5), "(1, 2.5)"),
        (tuple(range(50)), "50 values"),
        ({"a": 1, "b": 2}, "{a, b}"),
        (OrderedDict.fromkeys(range(50)), "50 entries"),
        ("x" * 99, f"'{'x' * 36}..."),
        (b"x" * 99, "99 bytes"),
        (Sample(), "Sample"),
        (npl.Outcome.STEP_LIMIT, "step limit"),
        (0, "0"),
    ],
    ids=str,
)
def test_a_field_is_shown_by_its_kind(value: Any, shown: str) -> None:
    assert repr(Sample("a", value)) == f"<Sample: text 'a', values {shown}>"
    assert repr(copy.deepcopy(Sample("a", value))) == repr(Sample("a", value))


def test_fields_that_do_not_fit_are_left_out() -> None:
    wide = type("W" * 120, (Sample,), {})
    assert repr(wide("a", "y" * 40, "z" * 40)).endswith(", ...>")
    for size in range(60):
        found = repr(wide("a" * size, "y" * size, {"k" * size: 1}))
        assert len(found) < MOST_CHARACTERS, size
