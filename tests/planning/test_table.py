"""What a table answers."""

import math
from dataclasses import replace

import numpy as np
import pytest

import needleplan as npl
from needleplan.errors import PoseError, TableError
from needleplan.planning import Action, Pose


def test_lookup_reads_the_nearest_state(table: npl.PolicyTable) -> None:
    step = 2 * math.pi / 36
    for x, y, heading, bevel, index in (
        (0.0, 20.0, 0.0, 1, (0, 20, 0, 1)),
        (10.4, 20.6, 0.4 * step, -1, (10, 21, 0, 0)),
        (60.0, 40.0, -step, -1, (60, 40, 35, 0)),
        (10.0, 20.0, 3 * step - 2 * math.pi, 1, (10, 20, 3, 1)),
    ):
        decision = table.lookup(x, y, heading, bevel, nearest=True)
        assert decision.value == table.values[index]
        assert decision.success == table.success[index]
        assert decision.action is Action(table.policy[index])


@pytest.mark.parametrize("turns", [-10, 10])
def test_a_heading_of_many_turns_is_looked_up_as_the_same_heading(table: npl.PolicyTable, turns: int) -> None:
    heading = 3 * 2 * math.pi / 36
    wound = Pose.wound((10.0, 20.0, heading + turns * 2 * math.pi, 1))
    assert table.lookup(wound) == table.lookup(10.0, 20.0, heading, 1)
    assert table.lookup(wound, nearest=True).value == table.values[10, 20, 3, 1]


def test_lookup_many_is_lookup_many_times(table: npl.PolicyTable) -> None:
    random = np.random.default_rng(0)
    poses = np.stack(
        [
            random.uniform(0, 60, 200),
            random.uniform(0, 40, 200),
            random.uniform(-6.28, 6.28, 200),
            random.choice([-1, 1], 200),
        ],
        axis=1,
    )
    many = table.lookup_many(poses)
    one = [table.lookup(x, y, heading, int(bevel)) for x, y, heading, bevel in poses]
    assert many.action.tolist() == [decision.action.code for decision in one]
    assert many.value.tolist() == [decision.value for decision in one]
    assert many.success.tolist() == [decision.success for decision in one]


def test_lookup_of_nothing(table: npl.PolicyTable) -> None:
    assert [len(answer) for answer in table.lookup_many(np.empty((0, 4)))] == [0, 0, 0]


@pytest.mark.parametrize(
    "pose",
    [
        (math.nan, 20, 0, 1),
        (0, math.inf, 0, 1),
        (0, 20, math.nan, 1),
        (0, 20, 0, math.nan),
        (-5, 20, 0, 1),
        (0, 45, 0, 1),
        (0, 20, 0, 0),
        (0, 20, 0, 2),
    ],
)
def test_poses_outside_or_no_numbers_are_refused(table: npl.PolicyTable, pose: tuple[float, ...]) -> None:
    with pytest.raises(PoseError):
        table.lookup_many([pose])
    with pytest.raises(PoseError):
        table.path(pose)
    with pytest.raises(PoseError):
        table.rollout(pose, runs=1)


def test_the_first_bad_row_is_named(table: npl.PolicyTable) -> None:
    with pytest.raises(PoseError, match="2"):
        table.lookup_many([(0, 20, 0, 1), (1, 20, 0, 1), (0, math.nan, 0, 1), (-1, 20, 0, 1)])


@pytest.mark.parametrize("poses", [[(1, 2, 3)], [1, 2, 3, 4], [["a", "b", "c", "d"]], None])
def test_arrays_of_another_form_are_refused(table: npl.PolicyTable, poses: object) -> None:
    with pytest.raises(PoseError):
        table.lookup_many(poses)  # type: ignore[arg-type]


def test_a_start_without_bevel_takes_the_cheaper_one(table: npl.PolicyTable) -> None:
    for heading in (-0.5, 0.0, 0.5):
        found = table.start((0, 20, heading))
        other = table.lookup(0, 20, heading, -found.bevel)
        assert table.lookup(*found).value <= other.value
    with pytest.raises(PoseError, match="x_mm, y_mm, heading_rad and bevel"):
        table.path((0, 20))


def test_a_table_of_another_shape_is_refused(table: npl.PolicyTable) -> None:
    with pytest.raises(TableError, match=r"policy = uint8 \(61, 41, 36, 1\): must be uint8 of the shape"):
        replace(table, policy=table.policy[..., :1])
    with pytest.raises(TableError, match="values = float64"):
        replace(table, values=table.values.astype(float))


def test_best_entry_has_the_highest_success_of_its_edge(table: npl.PolicyTable) -> None:
    best = table.best_entry(nearest=True)
    assert best.pose.x_mm == 0
    assert abs(best.pose.heading_rad) < math.pi / 2
    assert best.success > table.success[0, :, [*range(9), *range(28, 36)], :].max() - 0.001
    ahead = table.best_entry()
    decision = table.lookup(*ahead.pose)
    assert (decision.success, decision.value) == (ahead.success, ahead.value)
    decision = table.lookup(*best.pose, nearest=True)
    assert (decision.success, decision.value) == (best.success, best.value)


@pytest.mark.parametrize(
    ("edge", "inward"), [("left", 0.0), ("right", math.pi), ("bottom", math.pi / 2), ("top", -math.pi / 2)]
)
def test_entries_lead_into_the_workspace(table: npl.PolicyTable, edge: str, inward: float) -> None:
    pose = table.best_entry(edge).pose
    assert math.cos(pose.heading_rad - inward) > 0
    assert -math.pi < pose.heading_rad <= math.pi
    on_edge = {"left": pose.x_mm == 0, "right": pose.x_mm == 60, "bottom": pose.y_mm == 0, "top": pose.y_mm == 40}
    assert on_edge[edge]


def test_an_entry_can_be_pinned(table: npl.PolicyTable) -> None:
    assert table.best_entry(y_mm=12.3).pose.y_mm == 12.3
    assert table.best_entry("top", x_mm=7).pose.x_mm == 7
    with pytest.raises(PoseError, match=r"x_mm = 3: must not be given"):
        table.best_entry(x_mm=3)
    with pytest.raises(PoseError, match=r'edge = "lift": must be one of .* did you mean "left"'):
        table.best_entry("lift")
    for place in (99, -1, math.nan, math.inf):
        with pytest.raises(PoseError, match=rf"y_mm = {place}: must lie in the workspace, from 0 to 40 mm"):
            table.best_entry(y_mm=place)


def test_a_path_is_made_of_steps(table: npl.PolicyTable) -> None:
    path = table.path(table.best_entry().pose)
    assert path.outcome.name == "TARGET"
    assert path.poses.shape == (len(path.actions) + 1, 4)
    chords = np.hypot(*np.diff(path.poses[:, :2], axis=0).T)
    step = table.scenario.step_mm
    assert chords[:-1] == pytest.approx(2 * 40 * math.sin(step / 80), rel=1e-9)
    assert path.length_mm <= len(path.actions) * step + 1e-9
    assert path.length_mm > (len(path.actions) - 1) * step
    flips = path.poses[1:, 3] != path.poses[:-1, 3]
    np.testing.assert_array_equal(flips, path.actions == Action.ROTATE.code)
    assert len(path.turns) == flips.sum()
    assert path.start == table.best_entry().pose


def test_a_path_costs_what_its_steps_cost(table: npl.PolicyTable) -> None:
    reached = table.path(table.best_entry().pose)
    steps = len(reached.actions) * table.scenario.step_mm
    assert reached.cost == pytest.approx(steps + 4 * len(reached.turns))
    failed = table.path((19, 10, 0, 1))
    assert failed.outcome.name == "COLLISION"
    assert failed.cost > 10_000


def test_noise_of_a_seed_comes_again(table: npl.PolicyTable) -> None:
    start = table.best_entry().pose
    one, again, other = (table.path(start, noise_seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.poses, again.poses)
    assert one.poses.shape != other.poses.shape or not np.array_equal(one.poses, other.poses)


def test_poses_print_in_degrees() -> None:
    assert str(Pose(1, 2.5, math.pi / 6, -1)) == "x 1 mm, y 2.5 mm, heading 30 deg, bevel -1"
    assert str(Action.ROTATE) == "rotate, then insert"
