"""The examples in MATLAB's language and in C of the reference of the table file, run by Octave and a C compiler."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import needleplan as npl
from tests import pages

FOLDER = pages.ROOT / "docs" / "reference"
OCTAVE = Path(__file__).with_name("octave")
POSES = [(40.0, 36.0, 0.1, -1), (5.4, 20.4, -0.6, 1), (59.0, 39.0, 3.0, 1), (12.0, 7.0, 6.28, -1)]


def need(*programs: str) -> None:
    """Skip the test where a program is missing; in continuous integration it must be there."""
    for each in programs:
        if not shutil.which(each):
            assert os.environ.get("CI") != "true", f"{each} is missing"
            pytest.skip(f"{each} is not installed")


def run(*command: object, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(each) for each in command], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )


def test_matlab_reads_what_the_table_says(table: npl.PolicyTable, table_file: Path, tmp_path: Path) -> None:
    need("octave-cli", "h5dump")
    poses = "".join(f"  {x}, {y}, {heading}, {bevel};\n" for x, y, heading, bevel in POSES)
    lines = (FOLDER / "lookup.m").read_text().splitlines()
    (given,) = [number for number, line in enumerate(lines) if line.startswith("x_mm = ")]
    body = "\n".join(lines[given + 1 : -1])
    program = f"""if ! exist("h5read"), addpath("{OCTAVE}"); end
{chr(10).join(lines[:given])}
poses = [
{poses}];
for row = poses'
x_mm = row(1); y_mm = row(2); heading_rad = row(3); bevel = row(4);
{body}
printf("%d %.9g\\n", rotate_first, probability);
end
{lines[-1]}
printf("%d\\n", any(strfind(scenario, "needleplan.scenario/1")));
"""
    (tmp_path / "example.m").write_text(program.replace("table.h5", str(table_file)))
    done = run("octave-cli", "--quiet", "--no-init-file", "example.m", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    *found, scenario = done.stdout.split()
    assert scenario == "1"
    for pose, rotate_first, probability in zip(POSES, found[::2], found[1::2], strict=True):
        decision = table.lookup(*pose, nearest=True)
        assert rotate_first == f"{decision.action.code}"
        assert float(probability) == pytest.approx(decision.success, rel=1e-7)


@pytest.fixture(scope="module")
def lookup(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    need("h5cc")
    folder = tmp_path_factory.mktemp("c")
    warnings = ("-Wall", "-Wextra", "-Werror")
    done = run("h5cc", *warnings, FOLDER / "lookup.c", "-o", "lookup", "-lm", folder=folder)
    assert done.returncode == 0, done.stderr
    return folder / "lookup"


@pytest.mark.parametrize("pose", POSES)
def test_c_reads_what_the_table_says(
    pose: tuple[float, ...], lookup: Path, table: npl.PolicyTable, table_file: Path
) -> None:
    done = run(lookup, table_file, *pose, folder=lookup.parent)
    decision = table.lookup(*pose, nearest=True)
    assert done.stdout == f"{decision.action}; success {decision.success:.4f}, cost {decision.value:.4f}\n", done.stderr


@pytest.mark.parametrize("pose", [(-1, 20, 0, 1), (10, 4000, 0, 1), (10, 20, "nan", 1)])
def test_c_refuses_poses_outside(pose: tuple[object, ...], lookup: Path, table_file: Path) -> None:
    done = run(lookup, table_file, *pose, folder=lookup.parent)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "lookup: the pose is outside of the workspace\n")


def test_c_refuses_other_files(lookup: Path, tmp_path: Path) -> None:
    (tmp_path / "no.h5").write_text("no table")
    done = run(lookup, tmp_path / "no.h5", *POSES[0], folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.endswith("lookup: the file cannot be read\n")
