"""Studies: against brute force on invented records, and against the planner on small table sets."""

import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import needleplan as npl
from needleplan.errors import SweepError
from needleplan.planning import edge_profile
from needleplan.sweep import (
    Engine,
    Sweep,
    SweptParameter,
    TableSet,
    TableSetEntry,
    entry_map,
    make_table_set,
    pareto_front,
    quantity_map,
    sensitivities,
    wrong_parameters,
)
from needleplan.sweep._store import StoredPoint, TableSetStore
from tests.cli.commands import needleplan, refused
from tests.sweep.sweeps import write_sweep

A, B, C = ((0.0, 1.0, 2.0), (1.0, 2.0, 3.0, 4.0), ("u", "v"))


def invented(sweep: Sweep, points: list[tuple[object, ...]], records: Sequence[dict[str, object] | None]) -> TableSet:
    names = [each.title for each in sweep.parameters]
    store = TableSetStore(Path("nowhere"), "", sweep, ())
    entries = (
        TableSetEntry(dict(zip(names, values, strict=True)), record, store, StoredPoint({}, ""))
        for values, record in zip(points, records, strict=True)
    )
    return TableSet(sweep, tuple(entries))


def product(quantity: object) -> TableSet:
    """Return a table set over A x B x C with the success that a function gives."""
    parameters = [SweptParameter("k.a", values=A), SweptParameter("k.b", values=B), SweptParameter("k.c", values=C)]
    points: list[tuple[object, ...]] = list(itertools.product(A, B, C))
    return invented(Sweep("none", parameters), points, [{"success": quantity(*point)} for point in points])  # type: ignore[operator]


def test_shares_of_a_product_are_those_of_an_analysis_of_variance() -> None:
    table_set = product(lambda a, b, c: a**2 + 0.5 * b * (c == "v") + 0.1 * a * b)
    y = np.array([each.record["success"] for each in table_set]).reshape(3, 4, 2)
    found = {each.name: each for each in sensitivities(table_set)}
    for axis, name in enumerate("abc"):
        mean = y.mean(axis=tuple({0, 1, 2} - {axis}))
        assert found[name].share == pytest.approx(np.var(mean) / np.var(y))
        assert found[name].effect == pytest.approx(np.ptp(mean))
        assert np.allclose(found[name].main_effect, mean - mean.mean())
    assert sum(each.share for each in found.values()) < 1


def test_a_sample_of_an_additive_function_has_shares_that_sum_to_one() -> None:
    random = np.random.default_rng(3)
    a, b = random.uniform(0, 4, 50), random.uniform(-1, 1, 50)
    parameters = [SweptParameter("k.a", low=0.0, high=4.0), SweptParameter("k.b", low=-1.0, high=1.0)]
    sweep = Sweep("none", parameters, design="sampled", samples=50)
    y = 3 * a - 0.2 * a**2 + b**2
    table_set = invented(sweep, list(zip(a, b, strict=True)), [{"success": value} for value in y])
    found = {each.name: each for each in sensitivities(table_set)}
    assert found["a"].share == pytest.approx(np.var(3 * a - 0.2 * a**2) / np.var(y))
    assert found["b"].effect == pytest.approx(np.ptp(b**2))
    few = invented(sweep, list(zip(a, b, strict=True))[:5], [{"success": value} for value in y[:5]])
    with pytest.raises(SweepError, match=r"needs at least 6 tables with a success, .* there are 5"):
        sensitivities(few)


def test_nothing_beats_the_front_and_the_front_beats_everything_else() -> None:
    random = np.random.default_rng(8)
    goals = random.integers(0, 4, (60, 4)).astype(float)
    names = ("success", "clearance_mm", "length_mm", "turns")
    records: list[dict[str, object]] = [
        dict(zip(names, row, strict=True)) | {"reached": n % 7 > 0} for n, row in enumerate(goals.tolist())
    ]
    sweep = Sweep("none", [SweptParameter("k.n", values=list(range(60)))])
    table_set = invented(sweep, [(number,) for number in range(60)], records)
    front = {each.values["n"] for each in pareto_front(table_set)}
    better = goals * [1, 1, -1, -1]
    for number in range(60):
        beaten = any(
            (better[k] >= better[number]).all() and (better[k] != better[number]).any() for k in range(60) if k % 7
        )
        assert (number in front) == (number % 7 > 0 and not beaten)


def test_a_map_needs_one_value_of_the_others_and_sorts_its_levels() -> None:
    table_set = product(lambda a, b, c: a + 10 * b + 100 * (c == "v"))
    found = quantity_map(table_set.select(c="v"), "b", "a")
    assert (found.x, found.y) == (B, A)
    assert found.values.tolist() == [[a + 10 * b + 100 for b in B] for a in A]
    with pytest.raises(SweepError, match=r"vary: c is u or v. Give one value of each, such as --select c=u"):
        quantity_map(table_set, "b", "a")
    with pytest.raises(SweepError, match="is no parameter of this table set"):
        quantity_map(table_set, "d", "a")
    with pytest.raises(SweepError, match="is given for both axes"):
        quantity_map(table_set, "a", "a")
    with pytest.raises(SweepError, match='did you mean "success"'):
        quantity_map(table_set, "a", "b", "sucess")


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("table set")
    make_table_set(Sweep.read(write_sweep(folder)), folder / "store", Engine(workers=0))
    return folder / "store"


def test_the_profile_of_an_edge_has_the_best_entry() -> None:
    table = npl.plan("narrow_passage")
    for edge in ("left", "right", "bottom", "top"):
        profile = edge_profile(table, edge)
        best = table.best_entry(edge)
        assert np.nanmax(profile.success) == pytest.approx(best.success, abs=1e-3)
        assert profile.best == best
        number = len(profile.position_mm) // 3
        place = {"y_mm" if edge in ("left", "right") else "x_mm": float(profile.position_mm[number])}
        wanted = table.best_entry(edge, **place)  # type: ignore[arg-type]
        assert profile.success[number] == pytest.approx(wanted.success, abs=1e-3)


@pytest.mark.slow
def test_entries_over_a_parameter(small: Path) -> None:
    table_set = npl.TableSet.open(small).select(rotation=8.0)
    found = entry_map(table_set, "radius_mm")
    assert found.levels == (30.0, 40.0, 50.0)
    assert found.success.shape == (3, len(found.position_mm))
    profile = edge_profile(table_set[1].table(), "left")
    assert np.allclose(found.success[1], profile.success, atol=1e-5, equal_nan=True)
    with pytest.raises(SweepError, match=r"vary: rotation is 1.0 or 8.0. Give one value of each"):
        entry_map(npl.TableSet.open(small), "radius_mm")


def test_a_plan_for_the_true_values_is_the_right_plan_and_one_for_wrong_values_is_worse(tmp_path: Path) -> None:
    sweep = Sweep.read(write_sweep(tmp_path))
    radius = SweptParameter("needle.curvature_radius_mm", name="radius_mm", values=[30.0, 90.0])
    fine = [SweptParameter("grid.spacing_mm", values=[[1.0, 1.0]]), SweptParameter("motion.headings", values=[60])]
    make_table_set(replace(sweep, parameters=(radius, *fine)), tmp_path / "fine", Engine(workers=0))
    own, other = wrong_parameters(npl.TableSet.open(tmp_path / "fine"), runs=1000, radius_mm=30.0)
    assert own.values["radius_mm"] == 30.0
    assert own.success == own.replanned
    assert other.success < other.replanned - 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        ("map", "--figure", "a.png"),
        ("entries", "--select", "rotation=8", "--figure", "a.svg"),
        ("pareto", "--figure", "a.pdf"),
        ("sensitivity", "--figure", "a.png"),
        ("mismatch", "--planned", "radius_mm=30", "--planned", "rotation=8", "--runs", "50", "--figure", "a.png"),
    ],
)
def test_the_command(small: Path, tmp_path: Path, options: tuple[str, ...]) -> None:
    kind, *rest = options
    rest[-1] = str(tmp_path / rest[-1])
    done = needleplan("study", kind, small, *rest, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["study"] == kind
    assert Path(rest[-1]).stat().st_size > 5000


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("map", "--select", "rotation"), "--select = rotation: must be NAME=VALUE"),
        (("map", "--select", "rotatoin=1"), 'did you mean "rotation"'),
        (("mismatch",), "must name one table, but 6 tables have these values; give a value of radius_mm, rotation too"),
        (("mismatch", "--planned", "radius_mm=30"), "give a value of rotation too"),
        (("mismatch", "--planned", "radius_mm=31"), "--planned = radius_mm=31: no table has this value"),
        (("mismatch", "--planned", "radius_mm=30", "--runs", "0"), "--runs = 0: must be a whole number from 1"),
        (("map", "--select", "rotation=77"), "no table has this value; rotation is 1.0 or 8.0"),
        (("entries", "--select", "rotation=abc"), "no table has this value"),
        (("pareto", "--select", "rotation=9:2"), "a range is LOW:HIGH; write 2:9"),
        (("sensitivity", "--select", "rotation=2:7"), "no table has this value"),
        (("map", "--select", "rotation=1", "--select", "rotation=8"), "rotation is given twice"),
        (
            ("map", "--select", "rotation=1"),
            "only radius_mm varies in this selection of 3 tables; `needleplan study",
        ),
        (("map", "--x", "rotation", "--y", "rotation"), "x and y must be two parameters"),
        (("map", "--quantity", "start_success"), "no table of the selection has this quantity"),
        (("entries",), "vary: rotation is 1.0 or 8.0. Give one value of each, such as --select rotation=1.0"),
        (("map", "--planned", "rotation=1"), "--planned: is not an option of map; it belongs to mismatch"),
        (("pareto", "--quantity", "cost"), "--quantity: is not an option of pareto; it belongs to map and sensitivity"),
        (("entries", "--x", "rotation"), "--x: is not an option of entries; it belongs to map"),
        (("sensitivity", "--runs", "10"), "--runs: is not an option of sensitivity"),
        (("mismatch", "--y", "rotation"), "--y: is not an option of mismatch; it belongs to map and entries"),
        (("entries", "--y", "radius"), 'did you mean "radius_mm"'),
        (("map", "--figure", "a.jpg"), "a.jpg"),
    ],
)
def test_wrong_options(small: Path, options: tuple[str, ...], says: str) -> None:
    kind, *rest = options
    refused(needleplan("study", kind, small, *rest), says)


def test_tables_of_another_grid_are_left_out(tmp_path: Path) -> None:
    sweep = Sweep.read(write_sweep(tmp_path))
    parameters = (SweptParameter("grid.spacing_mm", name="grid", values=[[4.0, 4.0], [5.0, 5.0]]),)
    make_table_set(replace(sweep, parameters=parameters), tmp_path / "store", Engine(workers=0))
    table_set = npl.TableSet.open(tmp_path / "store")
    assert len(wrong_parameters(table_set, runs=10, grid=[4.0, 4.0])) == 1


def test_samples_and_lists_are_no_map() -> None:
    random = np.random.default_rng(1)
    points: list[tuple[object, ...]] = [tuple(row) for row in random.uniform(0, 1, (10, 3)).tolist()]
    parameters = [SweptParameter(f"k.{name}", low=0.0, high=1.0) for name in "abc"]
    records: list[dict[str, object]] = [{"success": 0.5}] * 10
    table_set = invented(Sweep("none", parameters, design="sampled", samples=10), points, records)
    with pytest.raises(SweepError, match=r"shows a and b, but .* c is one of 10 .* sensitivity` fits such tables"):
        quantity_map(table_set, "a", "b")
    with pytest.raises(SweepError, match=r"shows a, but .* b is one of 10 values .*; c is .*The sweep is sampled"):
        entry_map(table_set, "a")
    two = [SweptParameter(f"k.{name}", values=[0.0, 1.0, 2.0]) for name in "ab"]
    diagonal = invented(Sweep("none", two, design="list"), [(0.0, 0.0), (1.0, 1.0), (2.0, 2.0)], records[:3])
    with pytest.raises(SweepError, match=r"3 tables with 3 of 9 combinations. The sweep is a list"):
        quantity_map(diagonal, "a", "b")


def test_a_list_that_holds_all_combinations_is_a_map() -> None:
    two = [SweptParameter("k.a", values=[1.0, 1.0, 0.0, 0.0]), SweptParameter("k.b", values=[3.0, 5.0, 5.0, 3.0])]
    points: list[tuple[object, ...]] = [(1.0, 3.0), (1.0, 5.0), (0.0, 5.0), (0.0, 3.0)]
    records: list[dict[str, object] | None] = [{"success": 0.1}, None, {"success": 0.3}, {"success": 0.4}]
    found = quantity_map(invented(Sweep("none", two, design="list"), points, records), "a", "b")
    assert (found.x, found.y) == ((0.0, 1.0), (3.0, 5.0))
    assert np.array_equal(found.values, [[0.4, 0.1], [0.3, np.nan]], equal_nan=True)


def test_rows_of_entries_are_sorted() -> None:
    profiles: list[dict[str, object] | None] = [
        {"profile": {"position_mm": [0.0, 1.0], "success": [level, None]}} for level in (0.3, 0.1, 0.2)
    ]
    sweep = Sweep("none", [SweptParameter("k.a", low=0.0, high=4.0)], design="sampled", samples=3)
    found = entry_map(invented(sweep, [(3.0,), (1.0,), (2.0,)], profiles), "a")
    assert found.levels == (1.0, 2.0, 3.0)
    assert found.success[:, 0].tolist() == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    "study", [lambda a: quantity_map(a, "a", "b"), lambda a: entry_map(a, "a"), pareto_front, sensitivities]
)
def test_a_table_set_without_tables_is_refused(study: Callable[[TableSet], object]) -> None:
    whole = product(lambda *_: 0.5)
    with pytest.raises(SweepError, match="the selection has no tables"):
        study(whole.select(a=7.0))
    unmade = invented(whole.sweep, list(itertools.product(A, B, C)), [None] * 24)
    with pytest.raises(SweepError, match="none of the 24 tables is made; `needleplan sweep` makes them"):
        study(unmade)


def test_the_front_without_obstacles_has_no_clearance_and_one_without_paths_is_refused() -> None:
    sweep = Sweep("none", [SweptParameter("k.a", values=[0.0, 1.0])])
    record: dict[str, object] = {
        "success": 0.5,
        "clearance_mm": None,
        "length_mm": 60.0,
        "turns": 2,
        "reached": True,
    }
    table_set = invented(sweep, [(0.0,), (1.0,)], [record, record | {"turns": 1}])
    assert [each.values["a"] for each in pareto_front(table_set)] == [1.0]
    missed: list[dict[str, object] | None] = [record | {"reached": False}] * 2
    with pytest.raises(SweepError, match="none of the 2 tables has a path without noise that reaches the target"):
        pareto_front(invented(sweep, [(0.0,), (1.0,)], missed))


@pytest.mark.slow
def test_lists_are_selected_as_they_are_listed(tmp_path: Path) -> None:
    sweep = Sweep.read(write_sweep(tmp_path))
    parameters = (SweptParameter("grid.spacing_mm", name="grid", values=[[4.0, 4.0], [5.0, 5.0]]), *sweep.parameters)
    make_table_set(replace(sweep, parameters=parameters), tmp_path / "store", Engine(workers=0))
    done = needleplan("study", "map", tmp_path / "store", "--select", "grid=[5.0,5.0]", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["x"] == "radius_mm"
    refused(needleplan("study", "map", tmp_path / "store"), "such as --select rotation=1.0")


def test_a_product_of_one_parameter_has_its_whole_variance() -> None:
    sweep = Sweep("none", [SweptParameter("k.a", values=[1.0, 2.0, 4.0])])
    (found,) = sensitivities(invented(sweep, [(1.0,), (2.0,), (4.0,)], [{"success": y} for y in (0.5, 0.9, 0.2)]))
    assert (found.share, found.effect) == pytest.approx((1.0, 0.7))
    assert found.chance == 0.0


def test_an_incomplete_product_needs_one_table_more_than_coefficients() -> None:
    table_set = product(lambda a, b, c: a + b + (c == "v") + a * b)
    records = [each.record for each in table_set]
    points = [tuple(each.values.values()) for each in table_set]
    seven = {0, 3, 5, 6, 8, 11, 17}  # every value occurs: 1 + 2 + 3 + 1 = 7 coefficients
    for made in (set(range(23)), seven | {20}, seven):
        part = invented(table_set.sweep, points, [record if n in made else None for n, record in enumerate(records)])
        if len(made) > 7:
            assert all(0 < each.chance < 1 for each in sensitivities(part))
            continue
        rule = r"at least 8 tables .* 1 \+ 2 \(a\) \+ 3 \(b\) \+ 1 \(c\) = 7; there are 7"
        with pytest.raises(SweepError, match=rule):
            sensitivities(part)


def test_parameters_that_change_together_are_refused() -> None:
    numbers = np.linspace(0, 1, 12)
    sweep = Sweep("none", [SweptParameter(f"k.{name}", values=numbers.tolist()) for name in "abc"], design="list")
    points: list[tuple[object, ...]] = [(a, 2 * a + 1, (7 * n) % 12) for n, a in enumerate(numbers.tolist())]
    with pytest.raises(SweepError, match="the values of a, b change together in the 12 tables"):
        sensitivities(invented(sweep, points, [{"success": float(n % 5)} for n in range(12)]))


def test_two_values_in_a_list_have_a_straight_line() -> None:
    sweep = Sweep("none", [SweptParameter("k.a", values=[0.0, 0.0, 3.0, 3.0])], design="list")
    points: list[tuple[object, ...]] = [(0.0,), (0.0,), (3.0,), (3.0,)]
    (found,) = sensitivities(invented(sweep, points, [{"success": y} for y in (0.0, 0.2, 0.6, 0.8)]))
    assert found.effect == pytest.approx(0.6)


@pytest.mark.study
def test_the_share_by_chance_is_the_mean_share_of_a_parameter_without_effect() -> None:
    random = np.random.default_rng(11)
    parameters = [SweptParameter(f"k.{name}", low=0.0, high=1.0) for name in "ab"]
    sweep = Sweep("none", parameters, design="sampled", samples=20)
    shares, chances = [], []
    for _ in range(300):
        points: list[tuple[object, ...]] = [tuple(row) for row in random.uniform(0, 1, (20, 2)).tolist()]
        y = [3 * float(a) + noise for (a, _), noise in zip(points, random.normal(0, 1, 20).tolist(), strict=True)]  # type: ignore[arg-type]
        (found,) = [
            each for each in sensitivities(invented(sweep, points, [{"success": v} for v in y])) if each.name == "b"
        ]
        shares.append(found.share)
        chances.append(found.chance)
    # Standard error of the mean share: its standard deviation divided by sqrt(300), about 4 % of the mean.
    assert np.mean(shares) == pytest.approx(np.mean(chances), abs=3 * np.std(shares) / np.sqrt(300))


def test_every_study_says_how_many_tables_it_is_based_on(small: Path, tmp_path: Path) -> None:
    make_table_set(Sweep.read(write_sweep(tmp_path)), tmp_path / "store", Engine(workers=0), part=(1, 3))
    store = tmp_path / "store"
    counted = "Radius and rotation: 2 of 6 tables, 4 not made\n"
    planned = [
        f"--planned={name}={v}" for name, v in next(e for e in npl.TableSet.open(store) if e.record).values.items()
    ]
    for kind, *options in (["map"], ["pareto"], ["mismatch", *planned, "--runs", "20"]):
        assert needleplan("study", kind, store, *options).stdout.startswith(counted), kind
    done = needleplan("study", "entries", small, "--select", "rotation=8")
    assert done.stdout.startswith("Radius and rotation: 3 of 3 selected tables\n")
    assert json.loads(needleplan("study", "sensitivity", small, "--json").stdout)["based_on"] == "6 of 6 tables"


def test_correlated_parameters_whose_shares_exceed_the_variance_get_a_remark(
    monkeypatch: pytest.MonkeyPatch, small: Path
) -> None:
    numbers = np.linspace(0, 1, 12)
    parameters = [SweptParameter(f"k.{name}", low=0.0, high=2.0) for name in "ab"]
    sweep = Sweep("none", parameters, design="sampled", samples=12)
    points: list[tuple[object, ...]] = [(a, a + 0.01 * (n % 3)) for n, a in enumerate(numbers.tolist())]
    table_set = invented(sweep, points, [{"success": float(n % 3)} for n in range(12)])
    assert max(each.share for each in sensitivities(table_set)) > 1
    monkeypatch.setattr(TableSet, "open", lambda _: table_set)
    assert "correlated in these tables" in needleplan("study", "sensitivity", small).stderr


def test_a_map_is_printed_with_its_axes_and_shares_of_exactly_the_variance_get_no_remark(small: Path) -> None:
    done = needleplan("study", "map", small)
    assert done.stdout.splitlines()[1] == "  success for radius_mm = 30, 40, 50"
    assert done.stdout.splitlines()[2].startswith("  rotation = 1: ")
    assert "correlated" not in needleplan("study", "sensitivity", small, "--select", "rotation=1").stderr
