"""What callers may rely on whatever the kind of a table: tests that each kind inherits."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import needleplan as npl
from needleplan.errors import OutputError, PoseError
from needleplan.planning import Outcome, Table


class TableContract:
    """Tests of a table; `table` is a fixture of the class that inherits them."""

    def test_it_is_a_table(self, table: Any) -> None:
        assert isinstance(table, Table)
        assert table.stats.status == "converged"
        assert table.stats.states > 0
        assert table.stats.seconds > 0
        assert table.scenario.title in repr(table)
        assert len(repr(table)) < 200

    def test_an_entry_is_a_start_everywhere(self, table: Any) -> None:
        entry = table.best_entry()
        assert table.lookup(entry) == table.lookup(entry.pose) == table.lookup(tuple(entry.pose))
        assert table.start(entry) == entry.pose
        assert 0 < entry.success <= 1
        assert entry.value > 0
        assert table.path(entry).start == entry.pose

    def test_many_lookups_are_single_ones(self, table: Any) -> None:
        poses = np.array([entry.pose for entry in table.entries(3)], float)
        found = table.lookup_many(poses)
        assert len(found.action) == len(found.value) == len(found.success) == len(poses)
        for row, pose in enumerate(poses):
            alone = table.lookup(tuple(pose))
            assert getattr(alone.action, "code", alone.action) == found.action[row]
            assert float(found.value[row]) == pytest.approx(alone.value, rel=1e-6)
            assert float(found.success[row]) == pytest.approx(alone.success, rel=1e-6)

    def test_the_best_entry_is_the_first_of_the_list(self, table: Any) -> None:
        entries = table.entries(3)
        assert entries[0] == table.best_entry()
        places = np.array([entry.pose for entry in entries])[:, :2]
        assert len({tuple(place) for place in places.round(3)}) == len(entries) <= 3

    def test_a_path_has_poses_turns_length_and_outcome(self, table: Any) -> None:
        path = table.path(table.best_entry())
        assert path.outcome == "target"
        assert path.poses.shape[1] == len(table.best_entry().pose)
        assert path.turns.shape[1:] == path.poses.shape[1:]
        across = 3 if path.poses.shape[1] == 6 else 2
        chords = np.linalg.norm(np.diff(path.poses[:, :across], axis=0), axis=1)
        # The last step counts in full in the length, but ends where it meets the target.
        assert chords.sum() <= path.length_mm < 1.02 * (chords[:-1].sum() + chords.max())
        assert path.cost > 0
        assert tuple(path.end) == tuple(path.poses[-1])
        assert isinstance(path.plot(Figure().subplots()), Axes)
        noisy = [table.path(table.best_entry(), noise_seed=seed).end for seed in (1, 1, 2)]
        assert noisy[0] == noisy[1] != noisy[2]

    def test_a_rollout_has_outcomes_that_add_up(self, table: Any) -> None:
        runs = table.rollout(table.best_entry(), 400, seed=3)
        assert sum(runs.outcomes.values()) == runs.runs == 400
        assert set(runs.outcomes) == set(Outcome)
        assert runs.success == runs.outcomes["target"] / 400
        assert runs.interval[0] <= runs.success <= runs.interval[1]
        assert runs.start == table.best_entry().pose
        assert runs.predicted_success == table.lookup(table.best_entry()).success
        assert runs.mean_length_mm > 0
        assert runs.mean_turns >= 0
        assert runs == table.rollout(table.best_entry(), 400, seed=3) != table.rollout(table.best_entry(), 400, seed=4)
        assert len(runs.samples) == 40
        assert isinstance(runs.plot(Figure().subplots()), Axes)

    def test_the_plot_shows_a_probability_in_mm(self, table: Any) -> None:
        axes = table.plot(Figure().subplots())
        assert "(mm)" in axes.get_xlabel()
        assert axes.get_title(loc="left").startswith("Success probability")

    def test_an_xarray_dataset_has_labelled_axes(self, table: Any) -> None:
        data = table.to_xarray()
        assert set(data.data_vars) == {"values", "policy", "success"}
        assert data.attrs["digest"] == table.digest
        assert all(data[name].attrs["units"] == "mm" for name in ("x", "y"))
        assert 0 <= float(data.success.min()) <= float(data.success.max()) <= 1

    def test_a_written_table_opens_as_the_same(self, table: Any, tmp_path: Path) -> None:
        table.write(tmp_path / "table.h5")
        again = npl.open(tmp_path / "table.h5")
        assert type(again) is type(table)
        assert again.digest == table.digest
        assert again.best_entry() == table.best_entry()
        with pytest.raises(OutputError):
            table.write(tmp_path / "no" / "table.h5")

    @pytest.mark.parametrize("pose", [None, "here", (1.0,), (float("nan"),) * 4, (float("nan"),) * 6, (-1e6,) * 6])
    def test_a_wrong_pose_is_one_error(self, table: Any, pose: Any) -> None:
        for call in (table.lookup, table.path, table.rollout, table.start, lambda pose: table.lookup_many([pose])):
            with pytest.raises(PoseError):
                call(pose)

    @pytest.mark.parametrize("runs", [0, -1, 1.5, True, "many"])
    def test_a_wrong_number_of_runs_is_one_error(self, table: Any, runs: Any) -> None:
        with pytest.raises(PoseError, match="runs"):
            table.rollout(table.best_entry(), runs)
