"""The option `--buckling` of `needleplan insert`."""

from pathlib import Path

import pytest

from needleplan.cli import main
from needleplan.models import ForceModel2, ModelFile
from needleplan.models.deflection import UnsupportedShaft
from tests.control.scenes import small_table

FORCE = ForceModel2(sigma0=2.0, f1=0.1, sigma1=0.5, beta=0.3, sigma2=0.002, f2=-0.05, alpha=0.05)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("buckling")
    small_table().write(path / "table.h5")
    ModelFile(FORCE).write(path / "force.toml")
    return path


def said(folder: Path, capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 1) -> str:
    """Begin a run without a way to the target, so that nothing moves, and return what is written to stderr."""
    words = ["insert", str(folder / "table.h5"), "--start=0,39,85", "--json", *arguments]
    assert main(words) == code
    return capsys.readouterr().err


def test_a_force_limit_above_the_buckling_load_is_reported(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = said(folder, capsys, "--buckling", "230,150")
    assert "warning: the shaft buckles at 0.21 N with 150 mm unsupported, but the run stops at 5 N" in found
    assert f"up to a depth of {UnsupportedShaft(230, 150).holds_from_mm(5.0):.0f} mm" in found
    assert "buckles" not in said(folder, capsys, "--buckling", "2324,60")


def test_the_force_of_a_model_is_compared(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = str(folder / "force.toml")
    weak = said(folder, capsys, "--buckling", "1,150", "--force-model", model)
    assert "force.toml predicts" in weak
    assert "shorten the unsupported length by a guide" in weak
    strong = said(folder, capsys, "--buckling", "23240,150", "--force-model", model)
    assert "predicts" not in strong


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--buckling", "230"], ["--buckling", "2 numbers"]),
        (["--buckling", "230,-1"], ["length_mm = -1", "above 0"]),
        (["--force-model", "force.toml"], ["--force-model", "requires --buckling"]),
        (["--buckling", "230,150", "--force-model", "none.toml"], ["none.toml", "cannot be read"]),
    ],
)
def test_what_is_refused(
    arguments: list[str], words: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = said(folder, capsys, *arguments, code=2)
    assert all(word in found for word in words)
