"""Where the thesis prints each number and statement that a chapter compares.

A. Asadian, "Robot-Assisted Needle Insertion Using a Control Theoretic Approach", PhD thesis, The University of Western
Ontario. The text has no page numbers. Therefore a place is cited by its line in the text that `pdftotext` takes from
the thesis, counted from the abstract. For a table it is the line of the caption.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from needleplan.reports.comparison import Comparison, Origin

__all__ = ["CITATIONS", "Citation", "cited"]


@dataclass(frozen=True)
class Citation:
    """A place in the thesis: table, figure, equation or section, and the line of its text."""

    place: str
    line: int

    def __str__(self) -> str:
        return f"thesis, {self.place}, line {self.line}"


_WITHIN_SECTIONS = {
    "ch2/section 2.3/smaller sigma0": Citation("section 2.3.1", 929),
    "ch2/section 2.3/larger sigma1": Citation("section 2.3.1", 931),
    "ch2/section 2.3/sigma1 shapes": Citation("section 2.3.1", 932),
    "ch2/section 2.3/number of parameters": Citation("section 2.3.1", 925),
    "ch2/section 2.5.2/pairing": Citation("section 2.5.2", 1338),
    "ch2/section 2.5.2/Model II outperforms Model I": Citation("section 2.5.2", 1199),
    "ch2/section 2.5.2/final parameters": Citation("section 2.5.2", 1245),
    "ch2/section 2.5.2/A/A 10 mm/s": Citation("section 2.5.2", 1238),
    "ch2/section 2.5.2/A/A 6 mm/s": Citation("section 2.5.2", 1241),
    "ch3/Table 3.1/top speed of case 4": Citation("section 3.4.1", 2202),
    "ch3/Table 3.5/order of fitted models": Citation("section 3.4.1", 2198),
    "ch3/Table 3.5/Karnopp better than Model I": Citation("section 3.4.1", 2199),
    "ch3/Table 3.5/cases": Citation("section 3.4.1", 2198),
    "ch3/Table 3.6/": Citation("Table 3.6", 2215),
    "ch3/section 3.4.1/lambda": Citation("section 3.4.1", 1928),
    "ch4/section 4.3/less deformation": Citation("section 4.3.2", 2571),
    "ch5/Table 5.2/A, 15 mm/s/axial force": Citation("section 5.4.2", 3155),
    "ch5/Table 5.2/B, 15 mm/s/axial force": Citation("section 5.4.2", 3156),
    "ch5/Table 5.2/A, 15 mm/s/error of the radius": Citation("section 5.4.2", 3177),
    "ch5/Table 5.2/B, 15 mm/s/error of the radius": Citation("section 5.4.2", 3177),
    "ch5/Table 5.3/kf +20 % or vf -20 % is better": Citation("section 5.4.2", 3275),
    "ch5/Table 5.3/more robust": Citation("section 5.4.2", 3272),
    "ch6/problem/n by the formula": Citation("section 6.2", 3493),
    "ch6/problem/updates of 196 sweeps": Citation("section 6.4", 3893),
    "ch6/problem/mean of the noise": Citation("section 6.4", 3753),
    "ch6/problem/deviation of the noise": Citation("section 6.4", 3753),
    "ch6/statement/partitions within obstacles": Citation("section 6.4", 3789),
    "ch6/statement/the policy does not depend": Citation("section 6.4", 3899),
    "ch6/statement/H2 slightly outperforms": Citation("section 6.4", 3900),
    "ch6/statement/the best total time": Citation("section 6.4", 3907),
    "ch6/experiments/6.7": Citation("section 6.5", 3943),
    "ch6/experiments/6.8": Citation("section 6.5", 3949),
    "ch6/experiments/6.9": Citation("section 6.5", 3966),
    "ch6/figures/6.5": Citation("Figure 6.5", 3818),
    "ch6/section 6.5/6.7": Citation("section 6.5", 3943),
    "ch6/section 6.5/6.8": Citation("section 6.5", 3949),
    "ch6/section 6.5/6.9": Citation("section 6.5", 3966),
}

_SECTIONS = {
    "ch2/eq. 2.1": Citation("equation (2.1)", 919),
    "ch2/fig. 2.7a": Citation("section 2.5.2 on Figure 2.7", 1246),
    "ch2/fig. 2.7b": Citation("section 2.5.2 on Figure 2.7", 1246),
    "ch2/fig. 2.9a": Citation("section 2.5.2 on Figure 2.9", 1323),
    "ch2/fig. 2.9b": Citation("section 2.5.2 on Figure 2.9", 1323),
    "ch2/fig. 2.9c": Citation("section 2.5.2 on Figure 2.9", 1323),
    "ch2/table 2.1": Citation("Table 2.1", 1111),
    "ch2/table 2.2": Citation("Table 2.2", 1140),
    "ch2/table 2.3": Citation("Table 2.3", 1266),
    "ch3/Eq. 3.19": Citation("equation (3.19) and Table 3.4", 2066),
    "ch3/Fig. 3.7": Citation("section 3.4.3", 2313),
    "ch3/Table 3.2": Citation("Table 3.2", 1980),
    "ch3/Table 3.3": Citation("Table 3.3", 2015),
    "ch3/Table 3.4": Citation("Table 3.4", 2066),
    "ch3/Table 3.5": Citation("Table 3.5", 2106),
    "ch4/equation 4.2": Citation("equation (4.2)", 2477),
    "ch4/equation 4.3": Citation("equation (4.3)", 2514),
    "ch4/figure 4.3": Citation("Figure 4.3", 2560),
    "ch4/figure 4.4": Citation("Figure 4.4", 2587),
    "ch4/figure 4.5": Citation("Figure 4.5", 2606),
    "ch4/figure 4.6": Citation("Figure 4.6", 2614),
    "ch4/section 4.3": Citation("section 4.3", 2501),
    "ch5/Table 5.1": Citation("Table 5.1", 2961),
    "ch5/Table 5.2": Citation("Table 5.2", 3189),
    "ch5/Table 5.3": Citation("Table 5.3", 3238),
    "ch5/needle": Citation("section 5.4.2", 3151),
    "ch5/signs": Citation("section 5.4.2 on Table 5.3", 3272),
    "ch6/figures": Citation("Figure 6.4", 3808),
    "ch6/problem": Citation("section 6.4", 3748),
    "ch6/section 6.4": Citation("section 6.4", 3892),
    "ch6/section 6.5": Citation("section 6.5", 3917),
    "ch6/statement": Citation("Table 6.2", 3832),
    "ch6/table 6.2": Citation("Table 6.2", 3832),
    "ch6/table 6.3": Citation("Table 6.3", 3875),
}

CITATIONS = _SECTIONS | _WITHIN_SECTIONS
"""Citations by the beginning of the identities of comparisons. The longest beginning counts."""


def cited(comparisons: Iterable[Comparison]) -> list[Comparison]:
    """Return the comparisons; those with a number or statement of the thesis get their `source`.

    The source is the citation and the rest of the identity: row and column of a table.

    Parameters
    ----------
    comparisons
        Comparisons of one chapter.

    Returns
    -------
    list[Comparison]
        As many comparisons, in the same order.

    Raises
    ------
    KeyError
        If `CITATIONS` has no place for a number of the thesis.

    """
    return [
        replace(comparison, source=_source(comparison.id)) if comparison.origin is Origin.THESIS else comparison
        for comparison in comparisons
    ]


def _source(identity: str) -> str:
    beginnings = [beginning for beginning in CITATIONS if identity.startswith(beginning)]
    if not beginnings:
        raise KeyError(f"{identity}: no citation")
    within = identity.split("/", 2)[2]
    return f"{CITATIONS[max(beginnings, key=len)]}: {within}"
