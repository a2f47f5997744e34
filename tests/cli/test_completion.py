"""`needleplan completion`, in the shells that are installed."""

import shutil
import subprocess
from pathlib import Path

import pytest

from needleplan.cli.completion import SHELLS
from tests.cli.commands import needleplan, refused

shtab = pytest.importorskip("shtab", reason="shtab is not installed")


def run(shell: str, script: str, cwd: Path) -> list[str]:
    """Run a script in a shell that is installed, and return the words it prints."""
    if not shutil.which(shell):
        pytest.skip(f"{shell} is not installed")
    options = {"bash": ["--norc", "--noprofile"], "zsh": ["-f"], "fish": ["--no-config"]}[shell]
    done = subprocess.run(
        [shell, *options, "-c", script], cwd=cwd, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("completion")
    for shell in SHELLS:
        (place / f"script.{shell}").write_text(needleplan("completion", shell).stdout)
    (place / "vessel.toml").write_text("")
    (place / "results").mkdir()
    return place


def name_of(value: str | set[str]) -> str:
    """Return the name of a case; words of a set are sorted, so that every test process names it alike."""
    return value if isinstance(value, str) else " ".join(sorted(value))


LINES = [
    ("needleplan pl", {"plan"}, {"path"}),
    ("needleplan re", {"register", "recording", "reproduce"}, {"plan"}),
    ("needleplan plan --fo", {"--force"}, {"--figure"}),
    ("needleplan entry table.h5 --edge l", {"left"}, {"right"}),
    ("needleplan recording re", {"recover", "replay"}, {"info"}),
    ("needleplan plan ves", {"vessel.toml"}, set()),
    ("needleplan plan four", {"four_obstacles", "four_obstacles_thesis"}, {"brain"}),
    ("needleplan new mine --from pro", {"prostate"}, {"brain"}),
    ("needleplan simulate ste", {"steering"}, {"vessel.toml"}),
    ("needleplan reproduce ch", {"ch2", "ch6"}, {"diagnosis"}),
    ("needleplan reproduce ch2 dia", {"diagnosis"}, {"ch2"}),
    ("needleplan diagnose -o res", {"results"}, {"vessel.toml"}),
    ("needleplan reproduce --fig", set(), {"--figures"}),
]


BASH = """
    source script.bash
    COMP_WORDS=(LINE); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); COMP_LINE="LINE"; COMP_POINT=${#COMP_LINE}
    function=$(complete -p needleplan | sed 's/.*-F \\([^ ]*\\) .*/\\1/')
    COMPREPLY=()
    "$function" needleplan "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}" 2>/dev/null || true
    printf '%s\\n' "${COMPREPLY[@]}"
"""
SCRIPTS = {"bash": BASH, "fish": "source script.fish; complete -C 'LINE'"}


@pytest.mark.parametrize("shell", SCRIPTS)
@pytest.mark.parametrize(("line", "offered", "not_offered"), LINES, ids=name_of)
def test_a_shell_completes(shell: str, line: str, offered: set[str], not_offered: set[str], folder: Path) -> None:
    words = {word.rstrip("/") for word in run(shell, SCRIPTS[shell].replace("LINE", line), folder)}
    assert offered <= words
    assert not not_offered & words


def test_zsh_accepts_the_script(folder: Path) -> None:
    run("zsh", "autoload -Uz compinit && compinit -D -u && source script.zsh && whence _shtab_needleplan", folder)


@pytest.mark.parametrize("shell", SHELLS)
def test_every_script_has_all_commands_and_no_old_spelling(shell: str, folder: Path) -> None:
    text = (folder / f"script.{shell}").read_text()
    for word in ("scenarios", "tissue-motion", "recover", "rotation-speed-deg", "parquet", "completion"):
        assert word in text
    assert "rotation-speed " not in text
    assert "--figures" not in text
    assert "-l figures" not in text


def test_other_shells_are_refused() -> None:
    refused(needleplan("completion", "fsh"), "must be one of bash, zsh, fish", 'did you mean "fish"?')
