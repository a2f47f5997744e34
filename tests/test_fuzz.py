"""The parsers under a fuzzer that is guided by coverage, for a bounded number of inputs; benches/ has the long runs."""

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parents[1] / "benches" / "python" / "fuzz_parsers.py"
RUNS = {"robot": 1000, "machine": 50, "ati": 2000, "ndi": 800, "igtl": 400, "recording": 40}

# Memory that a parser may take, MB: the limit that libFuzzer has by itself.
MEMORY_MB = 2048


@pytest.mark.slow
@pytest.mark.parametrize(
    "target", [name if name in ("robot", "igtl") else pytest.param(name, marks=pytest.mark.study) for name in RUNS]
)
def test_no_input_gives_anything_but_a_value_or_its_error(target: str, tmp_path: Path) -> None:
    pytest.importorskip("atheris", reason="the fuzzer is installed with the tests on Linux only")
    resource = pytest.importorskip("resource", reason="not on Windows")
    # The largest memory of this process is counted as that of its children.
    limit_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024 + MEMORY_MB
    run = subprocess.run(
        [sys.executable, str(PROGRAM), target, f"-runs={RUNS[target]}", "-seed=1", f"-rss_limit_mb={limit_mb}"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-3000:]
    assert f"Done {RUNS[target]} runs" in run.stderr
