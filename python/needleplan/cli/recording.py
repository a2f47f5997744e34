"""`needleplan recording`: show, recover and export recordings, and replay recorded insertions."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.cli.answer import complain, note, one_line, print_first, print_json, print_summary, working
from needleplan.cli.options import add_answer, add_output, add_verify_key, read_table, require_free, require_outputs
from needleplan.cli.parser import Parser

if TYPE_CHECKING:
    from needleplan.recording import Recording

__all__ = ["add_to", "run_export", "run_info", "run_recover", "run_replay"]

FOLDERS = ("parquet", "rosbag")
FORMATS = ("hdf5", "csv", "mat", *FOLDERS)


def add_to(commands: Any) -> None:
    """Add this command and its subcommands to the program's parser."""
    parser: Parser = commands.add_parser(
        "recording",
        help="show, recover, export and replay recordings",
        description="Show, recover, export and replay recordings of a run (MCAP).",
    )
    subcommands = parser.add_subparsers(title="commands", metavar="{info,recover,export,replay}", required=True)
    info = subcommands.add_parser(
        "info", help="show the contents of a recording and verify its checksums",
        description="Show the contents of a recording and verify its checksums.",
    )  # fmt: skip
    info.add_argument("recording", metavar="RUN.mcap")
    info.add_argument("--events", action="store_true", help="print the events, one a line")
    add_answer(info)
    info.set_defaults(run=run_info)
    recover = subcommands.add_parser(
        "recover", help="write the readable messages of a partial or damaged recording",
        description="Write all readable messages of a partial or damaged recording, and report the missing ones. "
        "Exit code 1: messages are missing.",
    )  # fmt: skip
    recover.add_argument("recording", metavar="RUN.mcap.partial")
    add_output(recover, "RUN.mcap", "write this recording", required=True)
    add_answer(recover)
    recover.set_defaults(run=run_recover)
    export = subcommands.add_parser(
        "export", help="write a recording in another format",
        description="Write a recording as CSV, HDF5 or MATLAB file for `identify` (HDF5 and MATLAB files also hold all "
        "channels), as a folder of Parquet files, or as a ROS 2 bag.",
    )  # fmt: skip
    export.add_argument("recording", metavar="RUN.mcap")
    export.add_argument("--to", required=True, choices=FORMATS)
    add_output(export, "PATH", "write this file or folder", required=True)
    add_answer(export, verbose=False, json=False)
    export.set_defaults(run=run_export)
    again = subcommands.add_parser(
        "replay", help="run the insertion loop on a recorded insertion",
        description="Run the insertion loop on the samples of a recorded insertion, with the table of that insertion, "
        "and compare decisions and commands with the recorded ones. Exit code 1: they differ.",
    )  # fmt: skip
    again.add_argument("recording", metavar="RUN.mcap")
    again.add_argument("--table", required=True, metavar="TABLE.h5", help="policy table of the insertion")
    again.rename("--atlas", "--table-set")
    again.add_argument("--table-set", metavar="STORE", help="table set of the insertion, if it used one")
    add_verify_key(again)
    add_answer(again)
    again.set_defaults(run=run_replay)


def run_info(options: argparse.Namespace) -> int:
    """Show a recording and return the exit code 0. With `--events` and without `--json`, show only its events."""
    from needleplan.recording import Recording

    with working(options, "verifying"):
        recording = Recording.read(options.recording)
    if options.json:
        print_json(_record(recording))
        return 0
    if options.events:
        _print_events(recording)
        return 0
    recovery = recording.recovery
    closed = (
        "closed by its recorder" if recovery is None else f"recovered; {recovery.get('damaged_bytes')} damaged bytes"
    )
    print_summary(
        options,
        recording.session.title or options.recording,
        {
            "made by": f"{recording.session.made_by}, checksums verified",
            "ended": closed,
            "duration": f"{recording.duration_s:.3f} s",
            **_registration_line(recording),
            "messages": f"{sum(recording.counts.values()):,} on {len(recording.counts)} topics",
        },
        {
            **recording.session.digests,
            "files": ", ".join(recording.session.texts) or "none",
            **{
                topic: f"{count:,} messages, {recording.kinds[topic].name}" for topic, count in recording.counts.items()
            },
        },
    )
    return 0


def run_recover(options: argparse.Namespace) -> int:
    """Recover a recording and return the exit code: 1 if messages are missing or were lost, else 0."""
    from needleplan.recording import recover

    require_outputs(options, [options.recording], options.output)
    with working(options, "recovering"):
        done = recover(options.recording, options.output, overwrite=options.overwrite)
    if options.json:
        print_json(asdict(done))
    else:
        topics = [f"  {topic:<12} {count:,} messages" for topic, count in done.by_topic.items()]
        print_first(options, [options.output, *topics])
    if not done.closed:
        note(
            "this recording was not closed, or its end is lost; it has no count of its messages: how many are missing "
            "at its end is not known"
            if done.counted_s is None
            else "this recording was not closed, or its end is lost; its recorder counted the messages up to "
            f"{done.counted_s:.3f} s: later ones are missing and not counted"
        )
    damage = [f"{done.damaged_bytes:,} bytes at {done.places} places are damaged"] if done.damaged_bytes else []
    lost = [f"{count:,} messages of {topic} are missing" for topic, count in done.missing.items()]
    over = [f"{count:,} messages of {topic} were lost by the recorder" for topic, count in done.overflowed.items()]
    end = [f"nothing was recovered of the last {done.missing_s:.3f} s"] if done.missing and done.missing_s else []
    if damage or lost or over:
        complain("; ".join([*damage, *lost, *over, *end]))
    return int(bool(lost or over))


def run_export(options: argparse.Namespace) -> int:
    """Export a recording and return the exit code 0."""
    from needleplan.recording import Recording
    from needleplan.recording.export import FORMATS as WRITERS

    _require_export(options)
    with working(options, f"exporting to {options.to}"):
        more = {"overwrite": options.overwrite} if options.to in FOLDERS else {}
        remarks = WRITERS[options.to](Recording.read(options.recording), options.output, **more)
    for remark in remarks:
        note(remark)
    return 0


def _require_export(options: argparse.Namespace) -> None:
    """Raise OutputError if the output cannot be written. A recording is never overwritten, even with `--force`."""
    from needleplan.recording.export import require_no_recording

    if Path(options.output).is_dir() and options.to in FOLDERS:
        require_free(options, [options.output])
    else:
        require_no_recording(options.output)
        require_outputs(options, [options.recording], options.output)


def run_replay(options: argparse.Namespace) -> int:
    """Replay an insertion and return the exit code: 1 if decisions or commands differ from the recording, else 0."""
    from needleplan.control import replay
    from needleplan.recording import Recording

    table_set = None
    if options.table_set:
        from needleplan.sweep import TableSet

        table_set = TableSet.open(options.table_set)
    with working(options, "replaying"):
        done = replay(Recording.read(options.recording), read_table(options), table_set)
    if options.json:
        print_json({"same": done.same, "decisions": done.decisions, "recorded": done.recorded,
                    "differences": list(done.differences), "ending": done.report.outcome})  # fmt: skip
    else:
        first = done.differences[0] if done.differences else "none"
        lines = {"decisions": f"{done.decisions}, recorded {done.recorded}", "differences": str(len(done.differences)),
                 "first": first}  # fmt: skip
        print_summary(options, options.recording, lines)
    if not done.same:
        return complain(
            f"the decisions differ from the recorded ones: {(*done.differences, 'the replay made fewer decisions')[0]}"
        )
    return 0


def _registration_verdict(recording: Recording) -> dict[str, Any] | None:
    """Return the verdict on the registration of an insertion as JSON, or None if the recording has no registration."""
    content = recording.session.texts.get("registration.toml")
    if content is None:
        return None
    from needleplan.estimation.registration import Registration

    verdict = Registration.from_toml(content, f"{recording.path}: registration.toml").verdict
    return {"status": str(verdict.status), "noise_mm": verdict.noise_mm, "accepted": verdict.accepted,
            "reasons": list(verdict.reasons)}  # fmt: skip


def _registration_line(recording: Recording) -> dict[str, str]:
    verdict = _registration_verdict(recording)
    if verdict is None:
        return {}
    if verdict["status"] == "none":
        return {"registration": "without a verdict: it was not judged"}
    against = "; ".join([*filter(None, [verdict["accepted"]]), *verdict["reasons"]])
    return {"registration": f"{verdict['status']}{': ' if against else ''}{against}"}


def _record(recording: Recording) -> dict[str, Any]:
    session = recording.session
    return {
        "recording": str(recording.path),
        "title": session.title,
        "made_by": session.made_by,
        "digests": dict(session.digests),
        "files": list(session.texts),
        "registration": _registration_verdict(recording),
        "start_ns": recording.start_ns,
        "duration_s": recording.duration_s,
        "recovery": None if recording.recovery is None else dict(recording.recovery),
        "topics": {topic: {"messages": count, "kind": recording.kinds[topic].name}
                   for topic, count in recording.counts.items()},
    }  # fmt: skip


def _print_events(recording: Recording) -> None:
    from needleplan.recording import EVENT

    topics = [topic for topic in recording.counts if recording.kinds[topic].name == EVENT.name]
    for message in recording.messages(topics):
        words = [str(message.values.get(name) or "") for name in ("name", "cause", "text")]
        print(
            f"{(message.time_ns - recording.start_ns) * 1e-9:10.3f} s  " + "  ".join(map(one_line, filter(None, words)))
        )
