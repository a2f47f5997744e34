"""Report of the second edition of the diagnosis: a ranked table of hypotheses, and why each lost."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from needleplan.artifacts import json_values, version, write_whole
from needleplan.diagnosis.next_motion import programs, recorded_limits
from needleplan.diagnosis.posterior import (
    NextTrials,
    PosteriorAnswer,
    PosteriorDiagnosis,
    RankedHypothesis,
    next_trials,
    ranked_hypotheses,
)
from needleplan.models import ModelFile, Parent
from needleplan.reports.diagnosis import html
from needleplan.reports.diagnosis.folder import made_folder, remove_stale

__all__ = ["POSTERIOR_FILES", "PosteriorReport", "posterior_report"]

POSTERIOR_FILES = ("hypotheses.json", "hypotheses.html", "model.toml")
"""Names of the files that `PosteriorReport.write` may write; the last one only if the answer is NAMED."""

_UNDER_TEST = (
    "The second edition is under test: on data of a generator by another hand, it names fewer than half of the single "
    "effects, and half of its names and axes above 0.95 are wrong (benches/results/diagnosis_posterior.md)."
)
# Largest number of hypotheses in the table, and on the terminal.
_MOST, _MOST_SHOWN = 12, 5


@dataclass(frozen=True)
class PosteriorReport:
    """A diagnosis of the second edition with what its report shows."""

    found: PosteriorDiagnosis
    ranked: tuple[RankedHypothesis, ...]
    next_: NextTrials | None

    def lines(self) -> Iterator[str]:
        """Yield the lines for the terminal."""
        decision = self.found.decision
        yield f"{decision.answer}: {', '.join(decision.names)}{': ' if decision.names else ''}{decision.because}"
        for each in self.ranked[:_MOST_SHOWN]:
            yield f"  {each.probability:6.1%}  {each.words}: {each.because}"
        for name, parameter, value in self._estimates():
            ends = f"({value['low']:.4g} to {value['high']:.4g})"
            yield f"  {name}: {parameter} {value['value']:.4g} {value['unit']} {ends}"
        if self.found.decision.names:
            yield f"  held out: {self.found.shrink:.0%} of the gap above the noise is closed"
        if self.next_:
            yield f"  next: {self.next_.why}"
        for why in self.found.checked.lacks.values():
            yield f"  lacking: {why}"
        for remark in (*self.found.remarks, _UNDER_TEST):
            yield f"  remark: {remark}"

    def document(self) -> dict[str, Any]:
        """Return the content of `hypotheses.json` as JSON values; NaN and infinity become None."""
        decision = self.found.decision
        document = {
            "schema": "needleplan.hypotheses/1",
            "made_by": f"needleplan {version()}",
            "digest": self.found.digest,
            "answer": str(decision.answer),
            "because": decision.because,
            "names": list(decision.names),
            "axis": str(decision.axis) if decision.axis else None,
            "probability": decision.probability,
            "ranked": [asdict(each) for each in self.ranked],
            "estimates": [
                {"effect": name, "parameter": parameter, **value} for name, parameter, value in self._estimates()
            ],
            "held_out_shrink": self.found.shrink,
            "lacks": {str(lack): why for lack, why in self.found.checked.lacks.items()},
            "remarks": list(self.found.remarks),
            "next_motion": self._next(),
            "settings": [asdict(each) for each in self.found.settings.described()],
        }
        return dict(json_values(document))

    def html(self) -> str:
        """Return the text of `hypotheses.html`."""
        decision = self.found.decision
        along = f"depends on {decision.axis.label}" if decision.axis else ""
        names = ", ".join(decision.names) or along
        title = f"Diagnosis: {decision.answer}{f' ({names})' if names else ''}"
        body = [
            html.paragraph(f"{decision.because}."),
            html.heading("Hypotheses"),
            html.table(
                "The most probable first. One nat is a factor of 2.7 in probability.",
                ("hypothesis", "probability", "why it won or lost"),
                [(each.words, each.probability, each.because) for each in self.ranked],
            ),
        ]
        if rows := [(n, p, v["value"], v["low"], v["high"], v["unit"]) for n, p, v in self._estimates()]:
            body += [
                html.heading("Size of what is missing"),
                html.table(
                    "With 95 % intervals.", ("effect", "parameter", "value", "from", "to", "unit"), rows
                ),
                html.paragraph(f"Held out: {self.found.shrink:.0%} of the gap above the noise is closed."),
            ]  # fmt: skip
        if self.next_:
            body += [
                html.heading("Next motion"),
                html.paragraph(self.next_.why),
                html.table("Expected information of one trial", ("motion", "bits"), self.next_.considered),
            ]
        if self.found.checked.lacks:
            body += [html.heading("What the data lack"), html.items(self.found.checked.lacks.values())]
        if self.found.remarks:
            body += [html.heading("Remarks"), html.items(self.found.remarks)]
        settings = [
            (each.name, each.value, each.unit, each.effect, each.reason) for each in self.found.settings.described()
        ]
        body += [
            html.heading("Constants"),
            html.table("All constants of the model and of the answer", ("name", "value", "unit", "effect", "reason"),
                       settings),
            html.paragraph(_UNDER_TEST),
            html.paragraph(f"needleplan {version()}."),
        ]  # fmt: skip
        return html.page(title, body)

    def write(self, folder: str, file: ModelFile) -> tuple[str, ...]:
        """Write `POSTERIOR_FILES` into a folder, which is created if needed, and return the paths of written files.

        `file` is the base model. The corrected model is written only if the answer is NAMED; else a model that an
        earlier diagnosis wrote is removed. Raises OutputError.
        """
        place = made_folder(folder)
        written = [place / name for name in POSTERIOR_FILES]
        remove_stale(place, ("model.toml",))
        write_whole(written[0], (json.dumps(self.document(), indent=1) + "\n").encode())
        write_whole(written[1], self.html().encode())
        if self.found.decision.answer is not PosteriorAnswer.NAMED:
            return tuple(map(str, written[:2]))
        trials = (*self.found.checked.training, *self.found.checked.held_out)
        parents = (Parent("base", file.digest), *(Parent(each.trial, each.digest) for each in trials))
        remark = f"answer of the diagnosis {self.found.digest}: {self.found.decision.answer}"
        model = ModelFile(
            self.found.model, dict(self.found.base_estimates()), parents, (*file.remarks, remark), file.title
        )
        model.write(written[2])
        return tuple(map(str, written))

    def _estimates(self) -> Iterator[tuple[str, str, dict[str, Any]]]:
        """Yield effect, parameter and estimate of all parameters of the named effects."""
        for name in self.found.decision.names:
            for parameter, value in self.found.estimates.get(name, {}).items():
                yield name, parameter, asdict(value)

    def _next(self) -> dict[str, Any] | None:
        if self.next_ is None:
            return None
        return {
            "motions": [each.name for each in self.next_.motions],
            "about": [each.program.about if each.program else "as recorded" for each in self.next_.motions],
            "bits": self.next_.bits,
            "repeated_bits": self.next_.repeated_bits,
            "open_bits": self.next_.open_bits,
            "question": self.next_.question,
            "considered": dict(self.next_.considered),
        }


def posterior_report(found: PosteriorDiagnosis, trials: int = 1) -> PosteriorReport:
    """Return the report of a diagnosis, with a proposal of `trials` further trials."""
    limits = recorded_limits(found.calibration)
    tried = programs(found.calibration.given.channel, limits) if limits else ()
    return PosteriorReport(found, ranked_hypotheses(found, _MOST), next_trials(found, tried, trials))
