"""The lists of a benchmark."""

from __future__ import annotations

from collections import Counter

import pytest

from tests.blind import campaign as lists
from tests.blind.campaign import SMALL, Case, Counts, Purpose, Stratum, Variety, campaign
from tests.blind.force import generate
from tests.blind.outside import NEVER_TUNED, TUNING


@pytest.fixture(scope="module")
def full() -> dict[Purpose, list[Case]]:
    return {purpose: list(campaign(purpose)) for purpose in Purpose}


def test_no_seed_is_used_twice_or_for_both_purposes(full: dict[Purpose, list[Case]]) -> None:
    seeds = {purpose: [case.spec.seed for case in cases] for purpose, cases in full.items()}
    for purpose, used in seeds.items():
        assert len(set(used)) == len(used)
        assert all(seed in lists.SEEDS[purpose] for seed in used)
    assert not {*seeds[Purpose.TUNING]} & {*seeds[Purpose.REPORTING]}


def test_a_small_campaign_is_part_of_the_full_one(full: dict[Purpose, list[Case]]) -> None:
    known = {case.spec.seed: case for case in full[Purpose.REPORTING]}
    assert all(known[case.spec.seed] == case for case in campaign(Purpose.REPORTING, SMALL))


def test_enough_of_everything(full: dict[Purpose, list[Case]]) -> None:
    cases = full[Purpose.REPORTING]
    assert len(cases) >= 1000
    nulls = Counter(c.spec.heterogeneity for c in cases if c.stratum is Stratum.NULL and c.variety is Variety.RICH)
    assert nulls == dict.fromkeys(lists.HETEROGENEITY, 300)
    outside = {each.name for c in cases if c.stratum is Stratum.OUTSIDE for each in c.spec.effects}
    assert outside == {each.NAME for each in TUNING + NEVER_TUNED}
    assert len(TUNING + NEVER_TUNED) >= 6
    assert len(NEVER_TUNED) >= 3
    singles = [c.spec.effects[0].noise_multiple for c in cases if c.stratum is Stratum.SINGLE]
    assert min(singles) < 0.06
    assert max(singles) > 5.0


def test_what_is_never_tuned_with_is_not_in_the_tuning(full: dict[Purpose, list[Case]]) -> None:
    assert not any(case.never_tuned for case in full[Purpose.TUNING])
    assert sum(case.never_tuned for case in full[Purpose.REPORTING]) >= 3 * 6


def test_pairs_are_of_comparable_size(full: dict[Purpose, list[Case]]) -> None:
    pairs = [case.spec.effects for case in full[Purpose.REPORTING] if case.stratum is Stratum.PAIR]
    for first, second in pairs:
        assert first.name != second.name
        assert min(first.noise_multiple, second.noise_multiple) >= 0.2
        assert 0.25 <= first.noise_multiple / second.noise_multiple <= 4.0


@pytest.mark.slow
def test_a_pair_is_made_as_it_is_listed() -> None:
    case = next(case for case in campaign(Purpose.TUNING, SMALL) if case.stratum is Stratum.PAIR)
    _, truth = generate(case.spec)
    assert [each.name for each in truth.effects] == [each.name for each in case.spec.effects]


def test_a_stratum_is_not_overfilled() -> None:
    with pytest.raises(ValueError, match="a row of cases has 1000"):
        list(campaign(Purpose.TUNING, Counts(rich_nulls=1001)))
