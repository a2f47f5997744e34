"""Where an export goes: a new folder, a file that is no recording; and the libraries that an export needs."""

from __future__ import annotations

import contextlib
import importlib
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from mcap.writer import MCAP0_MAGIC

from needleplan.artifacts import may_replace, require_unread, require_writable
from needleplan.errors import Mistake, OutputError
from needleplan.recording._data_files import PathLike

__all__ = ["NewFolder", "optional_library", "require_no_recording"]


def optional_library(module: str, path: PathLike) -> Any:
    """Import an optional dependency and return it. If it is missing, raises OutputError with the install command."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        rule = f"needs {package}: install it with `pip install needleplan[export]`"
        raise OutputError(Mistake("", "", rule), os.fspath(path)) from error


class NewFolder:
    """Context manager that gives a temporary folder, which gets its final name at the end of the block.

    If the folder exists and may be overwritten, the new files are moved into it. After an exception the temporary
    folder is removed. Raises OutputError if the folder exists and may not be overwritten, or cannot be written.
    """

    def __init__(self, path: PathLike, overwrite: bool) -> None:
        self._target = Path(path)
        if self._target.is_dir() and overwrite:
            return
        if self._target.exists():
            raise OutputError("is there already", os.fspath(path))
        require_writable(path)

    def __enter__(self) -> Path:
        try:
            self._made = Path(tempfile.mkdtemp(prefix=f".{self._target.name}.", dir=self._target.resolve().parent))
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror}", str(self._target)) from error
        return self._made

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if error is None:
            self._made.chmod(0o755)
            if self._target.is_dir():
                try:
                    require_unread(self._target / file.name for file in self._made.iterdir())
                except OutputError:
                    shutil.rmtree(self._made, ignore_errors=True)
                    raise
                for file in self._made.iterdir():
                    file.replace(self._target / file.name)
                self._made.rmdir()
            else:
                self._made.rename(self._target)
            return
        shutil.rmtree(self._made, ignore_errors=True)
        if isinstance(error, OSError):
            raise OutputError(f"cannot be written: {error.strerror or error}", str(self._target)) from error


def require_no_recording(path: PathLike) -> None:
    """Raise OutputError if `path` cannot be written, or is a recording, because its data cannot be measured again."""
    require_writable(path)
    with contextlib.suppress(OSError):
        if Path(path).is_file():
            with Path(path).open("rb") as stream:
                if stream.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC:
                    raise OutputError("is a recording, which is never overwritten", os.fspath(path))
            may_replace(path)
