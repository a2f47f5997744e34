"""What the server answers on a diagnosis: verdict, effects, hypotheses, and the curves of every trial."""

from __future__ import annotations

import base64
import math
import shlex
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.errors import DataError, InputError, Mistake
from needleplan.page._files import LANGUAGES
from needleplan.page._requests import pack, page_html

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from needleplan.page._diagnosis_file import DiagnosisFile
    from needleplan.page._requests import Request

__all__ = ["DiagnosisPage"]

# Roles that the command gives to files.
_ROLES = ("holdout", "noise", "reference")
# Largest numbers of hypotheses in the list, and of parts of the gap.
_HYPOTHESES, _PARTS = 8, 6
# Largest p-value with which a part of the recordings is listed, as in the report.
_SMALL = 0.05


class DiagnosisPage:
    """Answers the requests of the page of a diagnosis, which was made before: nothing is computed again.

    Raises DataError if the document of the diagnosis is damaged.
    """

    document = "diagnosis.html"

    def __init__(self, opened: DiagnosisFile) -> None:
        self._opened = opened
        try:
            self._told = _told(opened)
            self._code = {"python": _python(opened), "command": _command(opened)}
        except (TypeError, KeyError, ValueError, AttributeError, ArithmeticError) as error:
            rule = f"is damaged: a value is not as `needleplan diagnose` writes it ({type(error).__name__}: {error})"
            raise DataError(rule, opened.source) from None

    @property
    def title(self) -> str:
        """Title of the diagnosis."""
        return str(self._told["title"])

    def start(self) -> dict[str, Any]:
        """Return the values that the page shows first: `source`, the name of the file, and `title`."""
        return {"source": self._opened.source, "title": self._told["title"]}

    def works(self) -> dict[str, Callable[[Request], bytes]]:
        """Return the functions that answer requests, by path."""
        return {"/api/diagnosis": self.diagnosis, "/api/code": self.code, "/api/page": self.page}

    def close(self) -> None:
        """Do nothing: the page has no threads."""

    def diagnosis(self, _: Request) -> bytes:
        """Return the message on the diagnosis: what was found, and the curves of all trials."""
        arrays: dict[str, NDArray[Any]] = {}
        for number, each in enumerate(self._opened.curves):
            arrays[f"time_s{number}"] = each.time_s.astype(np.float32)
            arrays[f"depth_mm{number}"] = each.depth_mm
            arrays[f"measured{number}"] = each.measured
            arrays[f"before{number}"] = each.before
            if each.after is not None:
                arrays[f"after{number}"] = each.after
        if self._opened.next_motion is not None:
            arrays["next_time_s"], arrays["next_depth_mm"] = self._opened.next_motion
        return pack(self._told, arrays)

    def code(self, request: Request) -> bytes:
        """Return Python or a command that diagnoses the same recordings again."""
        language = request.get("language")
        if language not in LANGUAGES:
            raise InputError(Mistake("language", f"{language}", "must be python or command"))
        text = self._code[language]
        if not text:
            rule = "is not known: this diagnosis.json does not say from which files it was made; diagnose again"
            raise InputError(Mistake("code", "", rule))
        return text.encode()

    def page(self, request: Request) -> bytes:
        """Return the page of the diagnosis as one HTML file that needs no server."""
        return page_html(
            {
                "start": {**self.start(), "offline": True},
                "messages": {"/api/diagnosis": base64.b64encode(self.diagnosis(request)).decode()},
                "code": self._code,
            },
            self.document,
            "diagnosis.js",
        )


def _told(opened: DiagnosisFile) -> dict[str, Any]:
    """Return what the page shows beside the curves."""
    document = opened.document
    words, lacks = document.get("words") or {}, document.get("lacks") or {}
    verdict, because = document["verdict"], document["because"]
    trials = [
        {name: each[name] for name in ("trial", "role", "samples", "digest")} | _residuals(opened, number)
        for number, each in enumerate(document["trials"])
    ]
    return {
        "title": str(words.get("title") or f"Diagnosis: {verdict}"),
        "sentences": _texts(words.get("answer") or [f"Verdict: {verdict}. {because[:1].upper()}{because[1:]}."]),
        "advice": _texts(words.get("advice") or [f"Missing data: {lack}." for lack in lacks.values()]),
        "verdict": verdict,
        "unit": document["unit"],
        "outputs": ["x", "y", "z"] if document["channel"] != "force_n" else ["force"],
        "noise_rms": _finite(document["noise"]["rms"]),
        "problem": opened.problem,
        "effects": [
            {name: each[name] for name in ("title", "meaning", "equation", "source")}
            | {"parameters": [_parameter(name, value) for name, value in each["parameters"].items()]}
            | {"share": _finite(each.get("share", 0.0))}
            for each in document["effects"]
        ],
        "hypotheses": [
            {"words": str(each["words"]), "probability": _finite(each["probability"]), "because": str(each["because"])}
            for each in document["hypotheses"][:_HYPOTHESES]
        ],
        "given": _given(document),
        "held_out": _held_out(document.get("held_out")),
        "where": _where(document["where"]),
        "next_motion": _next_motion(document.get("next_motion")),
        "trials": trials,
        "facts": {
            "model": document["model"], "made by": str(document.get("made_by", "")), "digest": document["digest"],
            **{f"data of {each['trial']}": each["digest"] or "not from a file" for each in document["trials"]},
        },
    }  # fmt: skip


def _residuals(opened: DiagnosisFile, number: int) -> dict[str, float | None]:
    """Return the RMS of the residual of a trial before and after, None where there is no curve."""
    if not opened.curves:
        return {"before_rms": None, "after_rms": None}
    curves = opened.curves[number]

    def rms(modelled: NDArray[np.float32]) -> float:
        return float(np.sqrt(np.nanmean((curves.measured.astype(float) - modelled) ** 2)))

    return {"before_rms": rms(curves.before), "after_rms": None if curves.after is None else rms(curves.after)}


def _parameter(name: str, value: dict[str, Any]) -> dict[str, Any]:
    unit = str(value["unit"]).replace("mm2", "mm\N{SUPERSCRIPT TWO}")
    return {"name": name, "unit": unit} | {key: _number(value[key]) for key in ("value", "low", "high")}


def _number(value: Any) -> float | None:
    """Return a number of the document, None for null. Raises TypeError or ValueError as `_finite`."""
    return None if value is None else _finite(value)


def _finite(value: Any) -> float:
    """Return a number of the document. Raises TypeError or ValueError for something else, as infinity."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{value!r} is no number")
    return float(value)


def _texts(value: Any) -> list[str]:
    """Return a list of texts of the document. Raises TypeError for something else."""
    if not isinstance(value, list):
        raise TypeError(f"{value!r} is no list of texts")
    return [str(each) for each in value]


def _given(document: dict[str, Any]) -> dict[str, Any] | None:
    """Return the gap of the given model and its parameters beside the data; None for an older document."""
    if "budget" not in document:
        return None
    keys = ("value", "low", "high", "given", "file_low", "file_high")
    parameters = [
        _parameter(str(each["name"]), each) | {"departs": bool(each["departs"])}
        | {key: _number(each[key]) for key in keys}
        for each in document["parameters"]
    ]  # fmt: skip
    budget = document["budget"]
    stages = [
        {"name": str(each["name"]), "rms": _finite(each["rms"]), "share": _number(each["share"])}
        for each in budget["all"]
    ]  # fmt: skip
    return {"stages": stages, "noise_rms": _finite(budget["noise_rms"]), "parameters": parameters}


def _held_out(found: dict[str, Any] | None) -> dict[str, float | None] | None:
    keys = ("before_rms", "after_rms", "floor_rms", "shrink")
    return None if found is None else {key: _number(found[key]) for key in keys}


def _where(parts: list[dict[str, Any]]) -> list[dict[str, Any]]:
    certain = [part for part in parts if part["p_value"] is not None and _finite(part["p_value"]) <= _SMALL]
    certain.sort(key=lambda each: _finite(each["share"]), reverse=True)
    return [{"label": str(each["label"]), "share": _finite(each["share"])} for each in certain[:_PARTS]]


def _next_motion(found: dict[str, Any] | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {"why": str(found["why"]), "role": str(found["role"])} | {
        "motions": [
            {"name": str(each["name"]), "about": str(each["about"]), "duration_s": _finite(each["duration_s"]),
             "file": None if each["file"] is None else str(each["file"])}
            for each in found["motions"]
        ]
    }  # fmt: skip


def _python(opened: DiagnosisFile) -> str:
    """Return Python that diagnoses again; an empty text if the files are not known."""
    source = opened.document.get("source")
    if not isinstance(source, dict):
        return ""
    roles = {file: name.upper() for name in _ROLES for file in source.get(name, ())}
    files = [*source["data"], *roles]
    options = []
    if source["accept_units"]:
        options.append("accept_units=True")
    if source["columns"]:
        options.append(f"columns=ColumnMap.parse({source['columns']!r}, surface_mm={source['surface_mm']!r})")
    if roles:
        options.append("roles={" + ", ".join(f"{name!r}: Role.{role}" for name, role in roles.items()) + "}")
    if source["rate_hz"] is not None:
        options.append(f"rate_hz={float(source['rate_hz'])!r}")
    if source.get("frame"):
        options.append(f"frame={source['frame']!r}")
    switches = ["references=False"] if source.get("without_references") else []
    switches += ["strict=True"] if source.get("strict") else []
    imports = ["ColumnMap", "read_records"] if source["columns"] else ["read_records"]
    lines = [
        "import needleplan as npl",
        "from needleplan.models import ModelFile",
        *(["from needleplan.models.effects import register_file"] if source["effects"] else []),
        f"from needleplan.recording import {', '.join(imports)}",
        *(["from needleplan.signals import Role"] if roles else []),
        "",
        *(f"register_file({name!r})" for name in source["effects"]),
        f"model = ModelFile.read({source['model']!r})",
        f"records = read_records({', '.join([repr(files), *options])})",
        f"found = npl.diagnose({', '.join(['model', 'records', *switches])})",
        "print(found.verdict, *found.names)",
        "npl.view(found)  # in a notebook",
    ]
    return "\n".join([*lines, ""])


def _command(opened: DiagnosisFile) -> str:
    """Return commands that diagnose again, into another folder; an empty text if the files are not known."""
    source = opened.document.get("source")
    if not isinstance(source, dict):
        return ""
    words = ["needleplan", "diagnose", source["model"], *source["data"]]
    for name in (*_ROLES, "columns", "effects"):
        words += [f"--{name}={each}" for each in source.get(name, ())]
    for name, key in (("surface", "surface_mm"), ("rate", "rate_hz")):
        if source[key] is not None:
            words.append(f"--{name}={float(source[key])!r}")
    words += [f"--frame={source['frame']}"] if source.get("frame") else []
    words += ["--accept-units"] if source["accept_units"] else []
    words += ["--without-references"] if source.get("without_references") else []
    words += ["--strict"] if source.get("strict") else []
    return f"{shlex.join([*words, '-o', 'again'])}\nneedleplan view again\n"
