"""Digest of an artefact, version of needleplan, checks of output paths, and atomic writing of files."""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import secrets
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from needleplan.artifacts.file_kinds import path_text
from needleplan.artifacts.read_files import was_read
from needleplan.artifacts.short_repr import CallRepr
from needleplan.errors import InputError, Mistake, OutputError, reading

__all__ = [
    "Parent",
    "digest",
    "expect_new",
    "is_device",
    "json_values",
    "move_into_place",
    "read_key",
    "remove_unfinished",
    "require_different",
    "require_folder",
    "require_key",
    "require_new",
    "require_writable",
    "version",
    "whole_file",
    "write_whole",
]


# Smallest length (bytes) of a secret key.
_LEAST_KEY_BYTES = 16

# Files that `write_whole` must create and not replace, because the user has not allowed overwriting.
_expected_new: set[Path] = set()

# Temporary files of `whole_file` that may exist.
_unfinished: set[Path] = set()


@dataclass(frozen=True)
class Parent(CallRepr):
    """An artefact from which another artefact was made.

    Parameters
    ----------
    name : str
        Name that a report shows, such as the name of a file or trial.
    digest : str
        Digest of the artefact, as `digest` returns it; empty if unknown.
    file : str
        Path of the artefact, relative to the folder of the file that names it; empty if unknown.

    Examples
    --------
    >>> from needleplan.artifacts import Parent, digest
    >>> Parent("trial 3", digest("text")).digest[:15]
    'sha256:982d9e3e'
    """

    name: str
    digest: str
    file: str = ""


def digest(content: str | bytes | memoryview) -> str:
    """Return the SHA-256 digest of a text (as UTF-8) or of bytes: `sha256:` and 64 hexadecimal digits."""
    data = content.encode() if isinstance(content, str) else content
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


def read_key(path: str | os.PathLike[str]) -> bytes:
    """Return the secret key in a file: its bytes without white space at both ends.

    Raises InputError if the file cannot be read or the key is shorter than 16 bytes.
    """
    with reading(path), Path(path).open("rb") as stream:
        key = stream.read(2**16).strip()
    try:
        require_key(key)
    except InputError as error:
        raise InputError(error.mistakes, os.fspath(path)) from None
    return key


def require_key(key: bytes) -> None:
    """Raise InputError if a secret key is not bytes, or shorter than 16 bytes."""
    if not isinstance(key, bytes) or len(key) < _LEAST_KEY_BYTES:
        found = f"{len(key)} bytes" if isinstance(key, bytes) else type(key).__name__
        raise InputError(Mistake("key", found, f"must have at least {_LEAST_KEY_BYTES} bytes"))


@cache
def version() -> str:
    """Return the version of the installed needleplan, for example `0.1.0`."""
    from importlib import metadata

    return metadata.version("needleplan")


def json_values(value: Any) -> Any:
    """Return a copy with JSON types only: tuples become lists, NaN and infinity become None."""
    if isinstance(value, Mapping):
        return {str(key): json_values(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [json_values(each) for each in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if hasattr(value, "tolist"):  # arrays and numbers of numpy
        return json_values(value.tolist())
    return value


def require_different(inputs: Iterable[str | os.PathLike[str]], outputs: Sequence[str | os.PathLike[str]]) -> None:
    """Raise OutputError if an output path is the same file as an input path or another output path.

    Paths of existing devices, pipes and folders, such as `/dev/null`, may be given several times.

    Parameters
    ----------
    inputs : iterable of str or path
        Paths of input files.
    outputs : sequence of str or path
        Paths of output files.

    Raises
    ------
    OutputError
        Two paths are the same file.
    """
    taken = {_place(path): f"replace {os.fspath(path)}, which is an input file" for path in inputs}
    for path in outputs:
        place = _place(path)
        if place in taken and (place.is_file() or not place.exists()):
            raise OutputError(Mistake("", "", f"cannot be written: it would {taken[place]}"), os.fspath(path))
        taken[place] = "be written twice"


def require_new(paths: Iterable[str | os.PathLike[str]]) -> None:
    """Raise OutputError if one of the paths is an existing file or folder.

    Existing devices and pipes are accepted. The message names the option `--force`, which allows overwriting.
    """
    there = [os.fspath(path) for path in paths if Path(path).is_file() or Path(path).is_dir()]
    rule = "exists already; --force overwrites it"
    if len(there) == 1:
        raise OutputError(Mistake("", "", rule), there[0])
    if there:
        raise OutputError([Mistake(path, "", rule) for path in there])


def expect_new(paths: Iterable[str | os.PathLike[str]]) -> None:
    """Forbid `write_whole` to replace one of these files; an earlier list is forgotten.

    A command that has made sure that its outputs are new calls this, because another program may create a file of that
    name while the command runs.
    """
    _expected_new.clear()
    _expected_new.update(map(_place, paths))


def _place(path: str | os.PathLike[str]) -> Path:
    return Path(os.path.realpath(path))


def require_writable(path: str | os.PathLike[str]) -> None:
    """Raise OutputError if the folder of `path` is missing or write-protected, or `path` is a folder.

    Call this before a long computation, so that its result is not lost when it is written.
    """
    _require_path(path)
    folder = Path(path).parent
    for wrong, reason in (
        (not folder.is_dir(), "no such folder"),
        (Path(path).is_dir(), "it is a folder"),
        (folder.is_dir() and not os.access(folder, os.W_OK), "no permission to write in its folder"),
    ):
        if wrong:
            raise OutputError(Mistake("", "", f"cannot be written: {reason}"), os.fspath(path))
    if not is_device(path):
        try:
            _create_and_remove(folder)
        except OSError as error:
            raise _unwritable(path, error) from error


def require_folder(path: str | os.PathLike[str]) -> None:
    """Raise OutputError if `path` is no folder and cannot become one, or no file can be created in it.

    Call this before a long computation. Folders that are created for the test are removed again.
    """
    place = Path(path)
    made: list[Path] = []
    try:
        for folder in (*reversed(place.parents), place):
            if not folder.is_dir():
                folder.mkdir()
                made.append(folder)
        _create_and_remove(place)
    except (OSError, ValueError) as error:
        files = [each for each in (place, *place.parents) if each.is_file()]
        reason = f"{files[0]} is a file" if files else getattr(error, "strerror", None) or error
        raise OutputError(Mistake("", "", f"cannot be a folder for the results: {reason}"), os.fspath(path)) from error
    finally:
        for folder in reversed(made):
            with contextlib.suppress(OSError):
                folder.rmdir()


def _create_and_remove(folder: Path) -> None:
    """Create a temporary file in a folder: permissions do not tell everything, as in /proc. Raises OSError."""
    with tempfile.TemporaryFile(dir=folder):
        pass


def move_into_place(source: Path, target: Path, *, replace: bool) -> None:
    """Rename a complete file.

    Parameters
    ----------
    source : pathlib.Path
        Complete file.
    target : pathlib.Path
        New path in the same folder.
    replace : bool
        Whether an existing file at `target` may be replaced. A file that a command has read is never replaced.

    Raises
    ------
    FileExistsError
        `target` exists and may not be replaced, even if it has appeared since the caller looked. `source` is kept.
    OSError
        The file cannot be renamed.
    """
    if replace and not was_read(target):
        source.replace(target)
        return
    try:
        os.link(source, target)  # refuses an existing target, which a rename on POSIX does not
    except FileExistsError:
        raise
    except OSError:
        # The file system has no hard links. An empty file, created exclusively, reserves the name.
        os.close(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        try:
            source.replace(target)
        except OSError:
            target.unlink(missing_ok=True)
            raise
    else:
        with contextlib.suppress(OSError):
            source.unlink()


def write_whole(path: str | os.PathLike[str], *chunks: bytes | memoryview) -> None:
    """Write a file atomically: at any moment, the path holds the complete old file or the complete new file.

    A device or pipe is written directly.

    Parameters
    ----------
    path : str or path
        Path of the file.
    *chunks
        Contents, one after the other.

    Raises
    ------
    OutputError
        `path` is not a path, or the file cannot be written.
    """
    path = path_text(path, OutputError)
    _require_path(path)
    if is_device(path):
        try:
            with Path(path).open("wb", buffering=0) as stream:
                _write_all(stream.fileno(), chunks)
        except OSError as error:
            raise _unwritable(path, error) from error
        return
    with whole_file(path) as partial:
        descriptor = os.open(partial, os.O_WRONLY)
        try:
            _write_all(descriptor, chunks)
        finally:
            os.close(descriptor)


def is_device(path: str | os.PathLike[str]) -> bool:
    """Return whether a path exists and is not a regular file.

    Devices, pipes and folders are such paths. `whole_file` cannot replace them, so they are written directly.
    """
    return Path(path).exists() and not Path(path).is_file()


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a new, empty temporary file in the folder of `path`, which becomes `path` at the end of the context.

    The temporary file is flushed to the disk and renamed, or removed if the context is left by an exception. Raises
    OutputError for an OSError in the context, and if `path` cannot be a file. If a file expected to be new
    (`expect_new`) has appeared meanwhile, that file is not replaced, the new one is kept beside it, and OutputError
    names it.
    """
    _require_path(path)
    try:
        target = Path(path).resolve()
        partial = target.with_name(f".{target.name[:100]}.{secrets.token_hex(4)}.partial")
        _unfinished.add(partial)  # before it exists: an interrupt may come between any two lines
        try:
            os.close(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
            yield partial
            _finish(partial, target, path)
        finally:
            with contextlib.suppress(OSError):
                partial.unlink()
            _unfinished.discard(partial)
    except OSError as error:
        raise _unwritable(path, error) from error


def _finish(partial: Path, target: Path, path: str | os.PathLike[str]) -> None:
    """Flush a complete file to the disk and rename it to `target`, or keep it beside a `target` that has appeared."""
    descriptor = os.open(partial, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    try:
        move_into_place(partial, target, replace=target not in _expected_new)
    except FileExistsError:
        kept = target.with_name(f"{target.stem[:100]}.{secrets.token_hex(4)}{target.suffix}")
        why = "is a file that this command has read" if was_read(target) else "has appeared while the command ran"
        partial.replace(kept)
        rule = f"{why}, and was not overwritten; the result is in {kept.name}"
        raise OutputError(Mistake("", "", rule), os.fspath(path)) from None
    _expected_new.discard(target)


def remove_unfinished() -> None:
    """Remove the temporary files of `whole_file`, for a process that is about to end without leaving its contexts."""
    for partial in list(_unfinished):
        with contextlib.suppress(OSError):
            partial.unlink()


def _unwritable(path: str | os.PathLike[str], error: OSError) -> OutputError:
    return OutputError(Mistake("", "", f"cannot be written: {error.strerror or error}"), os.fspath(path))


def _require_path(path: str | os.PathLike[str]) -> None:
    """Raise OutputError if no file can have this path, as with a circle of symbolic links or too long a name."""
    try:
        os.stat(path)  # noqa: PTH116  an error other than "not found" is wanted, which Path.exists hides
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(Mistake("", "", f"cannot be written: {reason}"), os.fspath(path)) from error


def _write_all(descriptor: int, chunks: tuple[bytes | memoryview, ...]) -> None:
    for chunk in chunks:
        rest = memoryview(chunk).cast("B")
        while rest:
            rest = rest[os.write(descriptor, rest) :]
