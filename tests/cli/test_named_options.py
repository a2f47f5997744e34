"""Messages of a command name its options, and what a file of another kind is for."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

import needleplan as npl
from needleplan.cli import main


@pytest.mark.parametrize("name", ["data.csv", "table.h5"])
def test_a_file_of_another_kind_is_named(
    name: str, tmp_path: Path, table: npl.PolicyTable, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / name
    if file.suffix == ".csv":
        file.write_text("time_s,depth_mm,force_n\n0,0,0\n")
    else:
        table.write(file)
    assert main(["plan", str(file)]) == 2
    assert "cannot be planned: its kind is" in capsys.readouterr().err


def test_options_are_named(tmp_path: Path, table: npl.PolicyTable, capsys: pytest.CaptureFixture[str]) -> None:
    table.write(tmp_path / "table.h5")
    assert main(["evaluate", str(tmp_path / "table.h5"), "--runs", "-5"]) == 2
    assert "--runs = -5: must be a whole number" in capsys.readouterr().err


def test_wrong_types_are_told_in_one_line() -> None:
    for call in (
        lambda: npl.Scenario.from_toml(3),  # type: ignore[arg-type]
        lambda: npl.open(pd.DataFrame({"a": range(9)})),  # type: ignore[arg-type]
        lambda: npl.models.Bicycle(curvature_per_mm="0.01"),  # type: ignore[arg-type]
    ):
        with pytest.raises(npl.NeedleplanError) as caught:
            call()
        assert "\n" not in str(caught.value)
