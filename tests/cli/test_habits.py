"""Rules that hold for all commands: help, suggestions, numbers, progress, overwriting, old words."""

import argparse
import io
import os
import pty
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import needleplan as npl
from needleplan.cli import answer
from needleplan.cli.parser import Parser, whole
from needleplan.cli.program import make_parser
from tests.cli.commands import needleplan, program, refused
from tests.conftest import SMALL


def commands(parser: argparse.ArgumentParser, name: str = "") -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield every command with its parser, subcommands too."""
    (subparsers,) = [each for each in parser._actions if isinstance(each, argparse._SubParsersAction)] or [None]
    if subparsers is None:
        yield name, parser
        return
    for word, each in subparsers.choices.items():
        yield from commands(each, f"{name} {word}".strip())


COMMANDS = dict(commands(make_parser()))
STARTS = {
    "plan": ("small.toml",), "path": ("table.h5",), "evaluate": ("table.h5", "--runs", "10"), "entry": ("table.h5",),
    "info": ("table.h5",), "scenarios": (),
    "case": ("nowhere", "--radius", "80", "--gauge", "20", "-o", "case.toml"),
    "new": ("mine", "-o", "new.toml"), "simulate": ("nowhere",),
    "identify": ("force", "nowhere.csv"), "register": ("--pivot", "nowhere.csv", "--points", "nowhere.csv"),
    "calibrate": ("nowhere.csv",),
    "lab": ("nowhere",), "insert": ("nowhere.h5",), "diagnose": ("nowhere.toml", "nowhere.csv", "-o", "found"),
    "compare": ("nowhere.toml", "nowhere.csv"), "predict": ("nowhere.csv", "--earlier", "nowhere.csv"),
    "recording info": ("nowhere.mcap",), "recording recover": ("nowhere.mcap", "-o", "again.mcap"),
    "recording export": ("nowhere.mcap", "--to", "csv", "-o", "run.csv"),
    "retract": ("--robot", "nowhere"), "stop": ("--robot", "nowhere"),
    "pause": ("--robot", "nowhere"), "resume": ("--robot", "nowhere"),
    "view": ("nowhere",), "sweep": ("nowhere.toml", "-o", "store"), "study": ("map", "nowhere"),
    "recording replay": ("nowhere.mcap", "--table", "table.h5"), "reproduce": ("ch7",), "completion": ("tcsh",),
    "doctor": (), "check-realtime": ("--seconds", "nan"), "check-robot": ("nowhere", "--may-move", "2"),
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, table: npl.PolicyTable) -> Path:
    path = tmp_path_factory.mktemp("habits")
    (path / "small.toml").write_text(SMALL)
    table.write(path / "table.h5")
    return path


def test_every_command_is_in_these_tests() -> None:
    assert set(STARTS) == set(COMMANDS)


# Those that a user begins with, and those that stop a needle, start in a process of their own.
FIRST = ("plan", "identify", "insert", "stop", "pause", "retract")


@pytest.mark.slow
@pytest.mark.parametrize("command", STARTS)
def test_every_command_starts(command: str, folder: Path) -> None:
    start = program if command in FIRST else needleplan
    done = start(*command.split(), *STARTS[command], cwd=folder)
    assert "Traceback" not in done.stderr
    if "nowhere" in " ".join(STARTS[command]):
        refused(done, "nowhere")
    elif STARTS[command] in (("ch7",), ("tcsh",)):
        refused(done, STARTS[command][0], "must be one of")
    elif "nan" in STARTS[command]:
        refused(done, "--seconds = nan: must be a finite number")
    else:
        assert done.returncode == 0, done.stderr
        assert done.stdout or command == "new"


def test_alone_the_program_prints_its_help() -> None:
    done = needleplan()
    assert (done.returncode, done.stderr) == (2, "")
    assert done.stdout == needleplan("--help").stdout
    done = needleplan("recording")
    assert (done.returncode, done.stderr) == (2, "")
    assert done.stdout == needleplan("recording", "--help").stdout


@pytest.mark.parametrize(
    ("arguments", "suggested"),
    [
        (("plam",), "plan"), (("recordings",), "recording"), (("recording", "inof"), "info"),
        (("plan", "x.toml", "--tabel"), None), (("plan", "x.toml", "--outptu=x.h5"), "--output"),
        (("diagnose", "m.toml", "d.csv", "--ouput", "found"), "--output"), (("--verison",), "--version"),
        (("entry", "x.h5", "--edge", "lefft"), "left"), (("identify", "forc", "x.csv"), "force"),
        (("recording", "export", "x", "--to", "parket", "-o", "x"), "parquet"), (("completion", "bsh"), "bash"),
    ],
)  # fmt: skip
def test_what_is_misspelt_gets_a_suggestion(arguments: tuple[str, ...], suggested: str | None) -> None:
    done = needleplan(*arguments)
    refused(done, f'did you mean "{suggested}"?' if suggested else "unknown option --tabel", "usage: needleplan")


OLD_WORDS = {
    "--for": (("identify", "curvature", "x.csv", "--for", "brain"), "--scenario"),
    "lab --for": (("lab", "--for", "0.2"), "--duration"),
    "--registration": (("lab", "--registration", "x.toml"), "--output"),
    "--rotation-speed": (("insert", "x.h5", "--rotation-speed", "10"), "--rotation-speed-deg"),
    "--roll-left": (("insert", "x.h5", "--roll-left=-0.02"), "--roll-left-deg"),
    "--overwrite": (("insert", "x.h5", "--overwrite"), "--force"),
    "atlas": (("atlas", "sweep.toml", "-o", "store"), "sweep"),
    "insert --atlas": (("insert", "x.h5", "--atlas", "store"), "--table-set"),
    "replay --atlas": (("recording", "replay", "x.mcap", "--table", "x.h5", "--atlas", "store"), "--table-set"),
    "identify --atlas": (("identify", "force", "x.csv", "--atlas", "x.toml"), "--force-library"),
    "identify --needle": (("identify", "force", "x.csv", "--needle", "18 GA"), "--needle-name"),
    "info --tissue": (("info", "published", "--tissue", "gel"), "--tissue-name"),
    "info --scenario": (("info", "x.h5", "--scenario"), "--print-scenario"),
    "identify --at": (("identify", "curvature", "x.csv", "--at", "90"), "--predict-at"),
    "entry --plane": (("entry", "x.toml", "--plane", "y.toml"), "--plane-out"),
    "lab --tracker": (("lab", "--tracker", "tcp"), "--tracker-line"),
    "--figures": (("reproduce", "ch5", "--figures", "x"), "--output"),
    "--seeds": (("reproduce", "diagnosis", "--seeds", "1e1"), "--runs"),
}


@pytest.mark.parametrize("old", OLD_WORDS)
def test_an_old_word_is_refused_with_the_new_one(old: str) -> None:
    arguments, new = OLD_WORDS[old]
    done = needleplan(*arguments)
    refused(done, f"{old.split()[-1]} is now {new}")
    assert len([line for line in done.stderr.splitlines() if line.startswith("needleplan")]) == 1


def test_old_words_are_neither_shown_nor_suggested() -> None:
    assert "--figures" not in needleplan("reproduce", "--figurse", "x").stderr.partition("needleplan reproduce:")[2]
    for name, parser in COMMANDS.items():
        assert not re.search(
            r"--(for|figures|seeds|rotation-speed|roll-left|overwrite)\b(?!-)", parser.format_help()
        ), name


@pytest.mark.parametrize(
    "arguments",
    [
        ("insert", "x.h5", "--force", "udp://127.0.0.1"), ("insert", "x.h5", "--force=udp://127.0.0.1"),
        ("insert", "--force", "udp://127.0.0.1", "x.h5"), ("insert", "x.h5", "--force", "udp://127.0.0.1", "-q"),
    ],
)  # fmt: skip
def test_an_address_after_force_is_refused_with_the_option_of_the_sensor(arguments: tuple[str, ...]) -> None:
    refused(needleplan(*arguments), "--force takes no address: write --force-sensor udp://127.0.0.1")


@pytest.mark.parametrize("text", ["-10,20,-5", "-.5,0,0", "-1e-3,2,3", "-3"])
def test_values_may_begin_with_a_negative_number(text: str) -> None:
    assert make_parser().parse_args(["path", "table.h5", "--start", text]).start == text


@pytest.mark.parametrize(
    ("text", "number"),
    [("7", 7), ("1e4", 10_000), ("-3", -3), ("2.50e1", 25), ("0", 0), ("1_000", 1000), ("9e17", 9 * 10**17)],
)
def test_whole_numbers(text: str, number: int) -> None:
    assert whole(text) == number


@pytest.mark.parametrize("text", ["1.5", "1e-1", "", "nan", "inf", "1e999999999", "1e18", "ten", "0x10", "1,000"])
def test_other_numbers_are_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="such as 500 or 1e4, of at most 18 digits"):
        whole(text)


def test_all_whole_numbers_of_all_commands_are_read_by_one_function() -> None:
    for name, parser in COMMANDS.items():
        assert not [each.option_strings for each in parser._actions if each.type is int], name


def test_one_option_has_one_name_and_one_unit() -> None:
    for name, parser in COMMANDS.items():
        options = parser._option_string_actions
        shown = {each for each, action in options.items() if action.help != argparse.SUPPRESS}
        assert ("-o" in shown) == ("--output" in shown), name
        if name == "sweep":  # adds to its folder, and overwrites nothing
            continue
        assert "--force" in shown or not {"-o", "--figure"} & shown, name
        assert {"-q", "--quiet"} <= shown or name == "completion", name
        assert not [each for each, action in options.items() if "RAD" in str(action.metavar) and each in shown], name


def test_an_option_of_several_values_that_is_repeated_loses_none() -> None:
    for name, parser in COMMANDS.items():
        for action in parser._actions:
            if action.option_strings and action.nargs in ("*", "+"):
                option, values = action.option_strings[0], argparse.Namespace(**{action.dest: None})
                for value in ("one", "two"):
                    action(parser, values, [value], option)
                assert "one" in str(getattr(values, action.dest)), f"{name} {option}"


@pytest.mark.slow
def test_the_summary_has_five_lines(folder: Path, tmp_path: Path) -> None:
    for arguments in (
        ("plan", folder / "small.toml", "-o", tmp_path / "t.h5", "--figure", tmp_path / "t.png"),
        ("path", folder / "table.h5"), ("evaluate", folder / "table.h5", "--runs", "1e2"),
        ("entry", folder / "table.h5"), ("info", folder / "table.h5"),
    ):  # fmt: skip
        done = needleplan(*arguments)
        assert done.returncode == 0
        assert 3 <= len(done.stdout.splitlines()) <= answer.SUMMARY_LINES
    more = needleplan("info", folder / "table.h5", "-v").stdout.splitlines()
    assert more[:5] == needleplan("info", folder / "table.h5").stdout.splitlines()
    assert len(more) > answer.SUMMARY_LINES


def test_long_answers_end_with_the_number_of_lines_left(capsys: pytest.CaptureFixture[str]) -> None:
    lines = [f"line {number}" for number in range(8)]
    answer.print_first(argparse.Namespace(verbose=False), lines)
    assert capsys.readouterr().out.splitlines() == [*lines[:4], "  ... 4 more lines with --verbose"]
    answer.print_first(argparse.Namespace(verbose=True), lines)
    answer.print_first(argparse.Namespace(verbose=False), lines[:5])
    assert capsys.readouterr().out.splitlines() == [*lines, *lines[:5]]


@pytest.mark.parametrize(
    ("arguments", "files"),
    [
        (("plan", "small.toml", "-o", "old.h5", "--figure", "old.png"), ("old.h5", "old.png")),
        (("path", "table.h5", "--figure", "old.png"), ("old.png",)),
        (("new", "OLD.toml"), ("OLD.toml",)),
        (("new", "other", "-o", "OLD"), ("OLD",)),
        (("simulate", "insertion", "-o", "old.csv"), ("old.csv",)),
        (("simulate", "insertion", "-o", "old.mcap"), ("old.mcap",)),
        (("identify", "force", "x.csv", "-o", "OLD", "--figure", "old.png"), ("OLD", "old.png")),
        (("identify", "curvature", "x.csv", "--scenario", "brain", "--scenario-out", "OLD"), ("OLD",)),
        (("register", "--pivot", "x.csv", "--points", "y.csv", "-o", "OLD"), ("OLD",)),
        (("lab", "-o", "OLD"), ("OLD",)),
        (("insert", "table.h5", "-o", "old.mcap", "--figure", "old.png"), ("old.mcap", "old.png")),
        (("diagnose", "m.toml", "x.csv", "-o", "old"), ("old/report.html", "old/model.toml")),
        (("recording", "recover", "x.mcap", "-o", "old.mcap"), ("old.mcap",)),
        (("recording", "export", "x.mcap", "--to", "csv", "-o", "old.csv"), ("old.csv",)),
        (("recording", "export", "x.mcap", "--to", "parquet", "-o", "old"), ("old",)),
        (("reproduce", "ch5", "-o", "old"), ("old/fig_5_1.png",)),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, tuple) else None,
)  # fmt: skip
def test_nothing_is_overwritten_unasked(
    arguments: tuple[str, ...], files: tuple[str, ...], folder: Path, tmp_path: Path
) -> None:
    for name in ("small.toml", "table.h5"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        if name == "old":
            (tmp_path / name).mkdir()
        else:
            (tmp_path / name).write_text("precious")
    before = {each: each.is_file() and each.read_bytes() for each in tmp_path.rglob("*")}
    done = needleplan(*arguments, cwd=tmp_path)
    refused(done, *files, "exists already; --force overwrites it")
    assert done.stderr.count("exists already") == len(files)
    assert {each: each.is_file() and each.read_bytes() for each in tmp_path.rglob("*")} == before


@pytest.mark.slow
def test_force_overwrites(folder: Path, tmp_path: Path) -> None:
    for name in ("mine.toml", "t.h5", "run.csv", "run.mcap"):
        (tmp_path / name).write_text("old")
    assert needleplan("new", "mine", "--from", folder / "small.toml", "--force", cwd=tmp_path).returncode == 0
    assert needleplan("plan", "mine.toml", "-o", "t.h5", "--force", cwd=tmp_path).returncode == 0
    for run in ("run.csv", "run.mcap"):
        assert needleplan("simulate", "insertion", "-o", run, "--force", cwd=tmp_path).returncode == 0
    assert not [each for each in tmp_path.iterdir() if each.read_bytes() == b"old"]
    assert npl.PolicyTable.read(tmp_path / "t.h5").scenario.title == "mine"
    assert needleplan("recording", "info", "run.mcap", cwd=tmp_path).returncode == 0


def test_devices_are_written_to() -> None:
    assert needleplan("new", "mine", "-o", os.devnull, "-q").returncode == 0


def test_quiet_is_quiet(folder: Path, tmp_path: Path) -> None:
    done = needleplan("plan", folder / "small.toml", "-o", tmp_path / "t.h5", "-q")
    assert done.stderr == ""
    assert done.stdout.startswith("Small\n")
    assert needleplan("plan", folder / "small.toml").stderr != "", "quiet holds for one command"


class Terminal(io.StringIO):
    """A standard error that is a terminal."""

    def isatty(self) -> bool:
        return True


def test_progress_appears_after_a_second_and_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(answer, "_DELAY_S", 0.2)
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    command = argparse.Namespace(json=False)
    with answer.working(command, "first") as tell:
        tell("second", 0.5)
        assert screen.getvalue() == ""
    time.sleep(0.4)
    assert screen.getvalue() == "", "a command that ends before is never shown"
    with answer.working(command, "third") as tell:
        end_s = time.monotonic() + 20
        while "third" not in screen.getvalue():
            assert time.monotonic() < end_s
            time.sleep(0.01)
        tell("fourth")
        answer.note("a remark [bold]")
    assert "a remark [bold]\n" in screen.getvalue()
    assert screen.getvalue().endswith("\x1b[2K") or screen.getvalue().endswith("\x1b[?25h\r\x1b[1A\x1b[2K")
    for silent in (argparse.Namespace(json=True), argparse.Namespace()):
        answer.set_quiet(not hasattr(silent, "json"))
        screen.truncate(0)
        with answer.working(silent, "fifth"):
            time.sleep(0.4)
        assert screen.getvalue() == ""
    answer.set_quiet(False)


def test_without_a_terminal_there_is_no_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(answer, "_DELAY_S", 0.0)
    screen = io.StringIO()
    monkeypatch.setattr(sys, "stderr", screen)
    with answer.working(argparse.Namespace(json=False), "first") as tell:
        time.sleep(0.1)
        tell("second")
    assert screen.getvalue() == ""


@pytest.mark.slow
def test_progress_of_a_plan_on_a_real_terminal(tmp_path: Path) -> None:
    text = SMALL.replace("tolerance = 1e-3", 'tolerance = 1e-9\nmethod = "vi"\ntime_limit_s = 2.5')
    (tmp_path / "slow.toml").write_text(text.replace("[solver]", "[grid]\nspacing_mm = [0.2, 0.2]\n[solver]"))
    master, slave = pty.openpty()
    command = [sys.executable, "-m", "needleplan", "plan", "slow.toml"]
    running = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=slave)
    os.close(slave)
    shown = b""
    with running, os.fdopen(master, "rb", buffering=0) as terminal:
        while True:
            try:
                piece = terminal.read(4096)
            except OSError:  # the other end has closed
                break
            if not piece:
                break
            shown += piece
        assert running.stdout is not None
        output = running.stdout.read()
    assert b"solving: " in shown
    assert b"sweeps, residual" in shown
    assert output.startswith(b"Small\n")
    assert b"\x1b" not in output


def test_parsers_of_subcommands_suggest_too() -> None:
    assert all(isinstance(parser, Parser) for parser in COMMANDS.values())
