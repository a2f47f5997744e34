"""`needleplan view`: serve the interactive page on this machine."""

from __future__ import annotations

import argparse
import secrets
import threading
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.artifacts import FileKind, file_format
from needleplan.cli.answer import note, working
from needleplan.cli.interrupt import handled_signals
from needleplan.cli.options import (
    add_answer,
    add_force,
    add_start,
    add_verify_key,
    read_table,
    require_ending,
    require_inputs_kept,
    require_outputs,
    start_pose,
)
from needleplan.cli.parser import Parser, whole
from needleplan.cli.uncertainty import add_uncertainty, read_registered, read_uncertainty
from needleplan.errors import InputError, Mistake
from needleplan.extras import require

if TYPE_CHECKING:
    from needleplan.page import AnyPage

__all__ = ["add_to"]

# Port that is used if it is free. The browser keeps unsaved edits by port, so it should be the same each time.
_USUAL_PORT = 8417

# Endings of files that are policy tables.
_TABLE_ENDINGS = (".h5", ".hdf5")


def add_to(commands: Any) -> None:
    """Add this command and its options to the program's parser."""
    parser: Parser = commands.add_parser(
        "view",
        help="see and change a plan in the browser",
        description="Serve a page on this machine that shows a plan and plans again while you drag entry, target and "
        "obstacles, or that shows a diagnosis before and after. Print its address, open it in the browser, and serve "
        "it until Ctrl-C. "
        "Needs `pip install needleplan[view]`, unless with --export.",
    )
    parser.add_argument(
        "file", metavar="FILE", nargs="?", default="four_obstacles",
        help="a scenario or an anatomy (.toml), the name of a shipped scenario, a policy table (.h5), the recording "
        "of an insertion (.mcap), or the folder that `needleplan diagnose` has written (four_obstacles)",
    )  # fmt: skip
    add_verify_key(parser)
    add_start(parser)
    parser.add_argument(
        "--table", metavar="TABLE.h5",
        help="policy table of the recording of a 3D insertion, or its anatomy (.toml) (the anatomy whose volume stands "
        "beside the recording)",
    )  # fmt: skip
    parser.add_argument("--export", metavar="FILE.html", help="write the page into one file, and serve nothing")
    add_force(parser)
    parser.add_argument(
        "--port", type=whole, metavar="N", help=f"port to serve on (default: {_USUAL_PORT}, or a free one)"
    )
    parser.add_argument("--no-browser", action="store_true", help="print the address only")
    add_uncertainty(parser)
    add_answer(parser, verbose=False, json=False)
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    """Serve the page until a signal ends it, and return the exit code 0. Raises InputError."""
    if options.port is not None and not 0 <= options.port <= 65535:
        raise InputError(Mistake("--port", f"{options.port}", "must be a port, from 0 to 65535; 0 is any free one"))
    if not options.export:
        require("starlette", "uvicorn")
    require_ending("--export", options.export, ".html", ".htm")
    require_outputs(options, [options.file, options.table, options.registration], options.export)
    if options.export:
        return _export(_page_of(options), options)
    from needleplan.page import HOST, bind, make_server

    with bind(options.port, _USUAL_PORT) as listening:
        page = _page_of(options)
        port, token = listening.getsockname()[1], secrets.token_urlsafe(24)
        server = make_server(page, token, port)
        ended = threading.Event()

        def run_server() -> None:
            try:
                server.run(sockets=[listening])
            finally:
                ended.set()

        thread = threading.Thread(target=run_server, name="needleplan page")
        with handled_signals(lambda _: ended.set()):
            thread.start()
            address = f"http://{HOST}:{port}/#token={token}"
            print(address, flush=True)
            note("the address holds a secret: keep it to yourself; Ctrl-C ends the page")
            if not options.no_browser:
                webbrowser.open(address)
            ended.wait()
            server.should_exit = True
            page.close()
            thread.join()
    return 0


def _export(page: AnyPage, options: argparse.Namespace) -> int:
    """Write the page of the plan into one file and return the exit code 0. Raises InputError."""
    from needleplan.artifacts import write_whole

    require_inputs_kept(options)
    with working(options, "solving and executing"):
        content = page.page(page.start())
    page.close()
    write_whole(options.export, content)
    note(f"wrote {options.export}, {len(content) / 1e6:.1f} MB; open it in a browser")
    return 0


def _page_of(options: argparse.Namespace) -> AnyPage:
    """Return the page of the file that the options name, with the promise of its entries. Raises InputError."""
    from needleplan.page import SpacePage

    uncertainty = read_uncertainty(options, read_registered(options.registration))
    page = _exact_page(options)
    if not uncertainty.is_exact:
        if not isinstance(page, SpacePage):
            page.close()
            raise InputError(
                Mistake("FILE", options.file, "must be an anatomy or a 3D table for a promise under errors")
            )
        page.promise_under(uncertainty)
    return page


def _exact_page(options: argparse.Namespace) -> AnyPage:
    from needleplan.page import DiagnosisFile, DiagnosisPage, is_diagnosis
    from needleplan.planning import read_problem

    kind, ending = file_format(options.file).kind, Path(options.file).suffix.lower()
    if kind is FileKind.TABLE or ending in _TABLE_ENDINGS:
        _refuse_table(options)
        options.table = options.file
        return _of_plan(read_table(options), options)
    if options.verify_key:
        raise InputError(Mistake("--verify-key", options.verify_key, "is for policy tables (.h5) only"))
    if kind is FileKind.RECORDING or ending == ".mcap":
        _refuse_start(options, "must not be given with a recording, which has its own")
        return _recorded(options)
    _refuse_table(options)
    if is_diagnosis(options.file):
        _refuse_start(options, "must not be given with a diagnosis")
        return DiagnosisPage(DiagnosisFile.read(options.file))
    return _of_plan(read_problem(options.file), options)


def _of_plan(plan: object, options: argparse.Namespace) -> AnyPage:
    from needleplan.page import page_of

    start = None if options.start is None else start_pose(options.start)
    try:
        return page_of(plan, options.file, start)
    except InputError as error:
        if not all(mistake.key == "start" for mistake in error.mistakes):
            raise
        raise InputError([Mistake("--start", options.start, mistake.rule) for mistake in error.mistakes]) from None


def _recorded(options: argparse.Namespace) -> AnyPage:
    """Return the page of a recorded insertion. Raises InputError if it cannot be shown."""
    from needleplan.page import Opened, Page, SpacePage, SpaceRun, is_space_run
    from needleplan.planning import SpaceTable
    from needleplan.recording import Recording

    recording = Recording.read(options.file)
    if not is_space_run(recording):
        _refuse_table(options)
        return Page(Opened.of_recording(recording))
    anatomy, table = None, None
    if options.table and file_format(options.table).kind is FileKind.ANATOMY:
        from needleplan.anatomy import Anatomy

        anatomy = Anatomy.read(options.table)
    elif options.table:
        table = SpaceTable.read(options.table)
    run = SpaceRun(recording, anatomy, options.table or "", table=table)
    return SpacePage(run.scenario, options.file, run.anatomy, run, table=table)


def _refuse_table(options: argparse.Namespace) -> None:
    if options.table:
        raise InputError(Mistake("--table", options.table, "is for recordings of 3D insertions"))


def _refuse_start(options: argparse.Namespace, rule: str) -> None:
    if options.start is not None:
        raise InputError(Mistake("--start", options.start, rule))
