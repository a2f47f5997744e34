"""The scenarios that come with the package, and the text of any scenario file."""

from __future__ import annotations

import os
from pathlib import Path

from needleplan.errors import InputError, Mistake, ScenarioError
from needleplan.scenario.rules import suggestion

__all__ = ["shipped", "text_of"]

_FOLDER = Path(__file__).parent.parent / "scenarios"


def shipped() -> list[str]:
    """Return the names of the shipped scenarios; `Scenario.read` takes a name where it takes a path."""
    return sorted(file.stem for file in _FOLDER.glob("*.toml"))


def text_of(
    path: str | os.PathLike[str],
    folder: Path = _FOLDER,
    kind: str = "scenario",
    error_kind: type[InputError] = ScenarioError,
) -> str:
    """Return the text of a scenario file, or of a shipped scenario where there is no file of that name.

    The same for files of another kind that are shipped in another folder. Raises ScenarioError, or the error that is
    given, where there is neither, or no UTF-8 text.
    """
    names = sorted(file.stem for file in folder.glob("*.toml"))
    source = os.fspath(path)
    try:
        if source in names and not Path(path).exists():
            return (folder / f"{source}.toml").read_text(encoding="utf-8")
        return Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        guess = suggestion(source, names)
        rule = f"no such file, and no shipped {kind} of that name ({', '.join(names)}){guess}"
    except UnicodeDecodeError as error:
        rule = f"is not TOML: not UTF-8 at byte {error.start}"
    except (OSError, ValueError) as error:
        rule = f"cannot be read: {getattr(error, 'strerror', None) or error}"
    raise error_kind(Mistake("", "", rule), source)
