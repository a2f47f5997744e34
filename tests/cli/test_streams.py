"""Text of files and devices is shown escaped, wherever a command prints it; faults of a terminal end nothing."""

import errno
import io
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

import needleplan as npl
from needleplan.cli.answer import AnswerStream, OutputFault, RemarkStream, one_line, printable
from needleplan.recording import EVENT, Recorder, Session
from tests.cli.commands import needleplan, program, refused
from tests.conftest import SMALL

EVIL = "liver\x1b[2J\x1b]0;owned\x07\x9b31m\u202eabc\nsuccess 100 %"
SHOWN = r"liver\x1b[2J\x1b]0;owned\x07\x9b31m\u202eabc\nsuccess 100 %"
SAFE = re.compile(r"[\x20-\x7e\n\t]*")


class Broken(io.StringIO):
    def write(self, _: str) -> int:
        raise OSError(errno.EIO, "Input/output error")


def test_what_a_terminal_obeys_is_escaped() -> None:
    assert one_line(EVIL) == SHOWN
    assert printable("a\n\tb \u00e9 \u03bc \u2212") == "a\n\tb \u00e9 \u03bc \u2212"
    for number in range(0x110000):
        if chr(number) not in "\n\t" and (number < 32 or 127 <= number < 160):
            assert printable(chr(number)) == f"\\x{number:02x}".replace("\\x0d", r"\r")


def test_characters_that_the_encoding_lacks_are_escaped() -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    AnswerStream(stream).write("5 \u00b1 1 \udcff")
    stream.flush()
    assert stream.buffer.getvalue() == rb"5 \xb1 1 \udcff"  # type: ignore[attr-defined]


def test_faults_of_the_answer_are_told_and_of_remarks_ignored() -> None:
    with pytest.raises(OutputFault):
        AnswerStream(Broken()).write("answer")
    assert RemarkStream(Broken()).write("remark") == 6
    assert RemarkStream(Broken()).without_escaping().write("\x1b") == 1


def test_no_command_prints_an_escape_sequence_of_a_file(tmp_path: Path) -> None:
    scenario = replace(npl.Scenario.from_toml(SMALL), title=EVIL)
    (tmp_path / "evil.toml").write_text(scenario.to_toml())
    npl.plan(scenario).write(tmp_path / "evil.h5")
    (tmp_path / "wrong.toml").write_text(scenario.to_toml() + '["key\\u001b[31m"]\n"x\\u001b" = "\\u001b[2J"\n')
    with Recorder(tmp_path / "evil.mcap", Session(EVIL)) as recorder:
        recorder.channel("/e", EVENT).put(recorder.session.monotonic_ns, {"name": EVIL, "cause": EVIL, "text": EVIL})
    (tmp_path / "evil.csv").write_text(f"time_s,force_n,{EVIL.splitlines()[0]},trial\n0,1,2,{EVIL.splitlines()[0]}\n")
    for command in (
        ("plan", "evil.toml"), ("plan", "wrong.toml"), ("path", "evil.h5"), ("entry", "evil.h5"), ("info", "evil.h5"),
        ("info", "evil.h5", "--print-scenario"), ("info", "evil.h5", "--json"), ("evaluate", "evil.h5", "--runs", "10"),
        ("recording", "info", "evil.mcap", "--verbose"), ("recording", "info", "evil.mcap", "--events"),
        ("identify", "force", "evil.csv"), ("insert", "evil.h5", "--start=0,39,85"), ("info", "no\x1b[31m.h5"),
    ):  # fmt: skip
        done = needleplan(*command, cwd=tmp_path)
        for text in (done.stdout, done.stderr):
            assert SAFE.fullmatch(text), (command, text)
            assert "\nsuccess 100 %" not in text, command
    events = needleplan("recording", "info", "evil.mcap", "--events", cwd=tmp_path).stdout.splitlines()
    assert [line.split("  ")[-3:] for line in events] == [[SHOWN] * 3]
    assert json.loads(needleplan("info", "evil.h5", "--json", cwd=tmp_path).stdout)["title"] == EVIL


def test_a_circle_of_links_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "a.h5").symlink_to("b.h5")
    (tmp_path / "b.h5").symlink_to("a.h5")
    (tmp_path / "a.png").symlink_to("a.png")
    (tmp_path / "small.toml").write_text(SMALL)
    loop = "Too many levels of symbolic links"
    for command in (
        ("plan", "small.toml", "-o", "a.h5"), ("plan", "small.toml", "--figure", "a.png"), ("plan", "a.h5"),
        ("info", "a.h5"), ("identify", "force", "a.h5"), ("recording", "info", "a.h5"), ("new", "mine", "-o", "a.h5"),
        ("simulate", "insertion", "-o", "a.h5"),
    ):  # fmt: skip
        refused(needleplan(*command, cwd=tmp_path), loop)


@pytest.mark.parametrize("spacing", ["1e-300", "5e-324", "1e308"])
def test_a_spacing_that_no_grid_has_is_one_clear_error(spacing: str, tmp_path: Path) -> None:
    for transition in ("nearest", "interpolated"):
        grid = f'[grid]\ntransition = "{transition}"\nspacing_mm = [{spacing}, {spacing}]\n[solver]'
        (tmp_path / "small.toml").write_text(SMALL.replace("[solver]", grid))
        refused(needleplan("plan", "small.toml", "-q", cwd=tmp_path), "small.toml: ")


def test_a_name_that_is_no_text_is_shown() -> None:
    done = program("info", b"/nowhere\xff.h5".decode(errors="surrogateescape"))
    refused(done, r"/nowhere\udcff.h5: cannot be read: No such file")
