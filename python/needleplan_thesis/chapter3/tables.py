"""Tables 3.1 to 3.4: conditions and parameters."""

from __future__ import annotations

from collections.abc import Sequence

from needleplan.reports.comparison import Agreement, Comparison, measured
from needleplan_thesis.chapter3.fits import CaseFits
from needleplan_thesis.chapter3.published import CASES, MODEL_I, MODEL_II, MODEL_III_B, Printed

__all__ = ["parameters", "recovered"]

_NO_DATA = "no measured data were published; ours: identified from data of III-B with Table 3.4 and 15 mN of noise"
_ROUND_TRIP = "a round trip, no evidence on tissue: data made with the printed values give them back"
_STATIC = (
    "mu_c, alpha and sigma2 of a static model trade off (standard deviations above 50 %): another point of the valley"
)
_SIGMA0 = "a patch of 76 mm is 50 to 2000 times g/sigma0: the force of Model I does not depend on sigma0 by 1 %"


def parameters(fits: Sequence[CaseFits]) -> list[Comparison]:
    """Compare the identified parameters of Models I, II and III-B with Tables 3.2 to 3.4; data from III-B."""
    speed = CASES[4].top_speed_mm_s
    rows = [
        Comparison(
            "ch3/Table 3.1/top speed of case 4, which the text has beyond -10 mm/s", 10.0, speed, "mm/s",
            Agreement.REPRODUCED if speed > 10 else Agreement.NOT_REPRODUCED,
            "the amplitude is from zero to peak: from peak to peak the top speed would be 7.1 mm/s",
        )
    ]  # fmt: skip
    for each in fits:
        for table, label, printed in (
            ("3.2", "I", MODEL_I), ("3.3", "II", MODEL_II), ("3.4", "III-B", MODEL_III_B),
        ):  # fmt: skip
            for name, value in printed[each.case].items():
                rows.append(_row(f"ch3/Table {table}/case {each.case}, {name}", value, each, label, name))
    return rows


def _row(identity: str, printed: Printed, fits: CaseFits, label: str, name: str) -> Comparison:
    estimates = fits.fits[label].estimates
    if name not in estimates:
        return Comparison(identity, printed.mean, None, "", Agreement.IMPOSSIBLE, _SIGMA0)
    found = estimates[name]
    reason = {"I": f"{_NO_DATA}; {_STATIC}", "II": _NO_DATA, "III-B": _ROUND_TRIP}[label]
    reason = f"{reason}; ours +- {found.sd:.2g}, printed +- {printed.sd:g}"
    # The table prints three digits: a standard deviation of 0.000 is up to half of the last one.
    if abs(found.value - printed.mean) <= 2 * max(printed.sd, 5e-4):
        return Comparison(identity, printed.mean, found.value, found.unit, Agreement.REPRODUCED, reason)
    return measured(identity, printed.mean, found.value, found.unit, reason)


def recovered(fits: Sequence[CaseFits]) -> list[Comparison]:
    """Say which lambda comes back, and how little it rests on."""
    rows = []
    for each in fits:
        errors = {exponent: 1e3 * found.rmse for exponent, found in each.exponents.items()}
        slopes = {exponent: found.estimates["mu_c"].value for exponent, found in each.exponents.items()}
        said = ", ".join(f"{exponent:g}: {errors[exponent]:.1f} mN, mu_c {slopes[exponent]:.2f}" for exponent in errors)
        published = 5.0 if each.case == 1 else None
        verdict = Agreement.OURS if published is None else (
            Agreement.REPRODUCED if each.exponent == published else Agreement.NOT_REPRODUCED
        )  # fmt: skip
        rows.append(Comparison(
            f"ch3/section 3.4.1/lambda of the smallest error, case {each.case}, data from {each.generator}",
            published, each.exponent, "", verdict, said,
        ))  # fmt: skip
    return rows
