"""What to measure next, on the page of a diagnosis."""

from __future__ import annotations

from collections.abc import Iterator

from needleplan.diagnosis.next_motion import NOTHING, Exploring, NextMotion, Revealing, Separating
from needleplan.reports.diagnosis import html, pictures

__all__ = ["next_part"]


def next_part(each: NextMotion | None) -> Iterator[str]:
    """Yield the part of the page on the next motion; nothing where there is none."""
    if each is None:
        return
    program = each.program
    yield html.heading("What to measure next")
    yield html.paragraph(f"One more trial, role {each.role}: {program.about}. {_promise(each)}")
    yield html.paragraph("It is next_motion.toml beside this page: its head says how it is simulated, and how it is "
                         "made on a robot.")  # fmt: skip
    text = f"Depth over time of the proposed motion, {program.name}: {program.about}"
    yield html.picture(pictures.motion_figure(each.motion), text,
                       f"The motion, {each.motion.time_s[-1]:.0f} s.")  # fmt: skip
    match each:
        case Separating() if NOTHING not in {pair.rival for pair in each.separations}:
            yield html.table(
                "How far one more trial tells the effects apart; 1 is the lead that a name needs",
                ("if this is true", "against", "this motion", "the last one again", "this motion is enough"),
                [(pair.true, pair.rival, pair.thresholds, again.thresholds, f"{pair.resolves:.0%}")
                 for pair, again in zip(each.separations, each.repeated, strict=True)],
            )  # fmt: skip
        case Revealing():
            yield html.table(
                "From which size on an effect would be named",
                ("effect", "now", "with this motion", "with the last one again", "unit"),
                [(one.effect, one.now, one.after, one.repeated, one.unit or "1") for one in each.effects],
            )
        case Exploring():
            ordered = sorted(each.considered, key=lambda one: one[1], reverse=True)
            yield html.table("What one more trial says of the gap, in bits", ("motion", "bits"), ordered)


def _promise(each: NextMotion) -> str:
    if not isinstance(each, Separating) or NOTHING in {pair.rival for pair in each.separations}:
        return each.why
    odds = (
        f"It decides between the effects in question with a probability of {each.resolves:.0%}; the last training "
        f"motion, once more, with {each.repeated_resolves:.0%}."
    )
    return f"{odds} {each.why}"
