"""Rules and tables: every mistake at once, by key, value and rule, and a suggestion for what is misspelt."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.artifacts import Parent
from needleplan.config import (
    Choice,
    ConfigTable,
    Flag,
    Given,
    Integer,
    Keyed,
    Maybe,
    Number,
    Numbers,
    Pair,
    ParentList,
    Rule,
    Sign,
    Subtable,
    TableList,
    Text,
    Texts,
    Violation,
    parse_toml,
    raw_of,
    read_toml,
    ruled,
    suggestion,
    text_of,
    toml_text,
)
from needleplan.errors import DataError, Mistake, ModelError


class Colour(StrEnum):
    RED = "red"
    GREEN = "green"


def _ordered(low: float, high: float) -> Iterator[Mistake]:
    if low > high:
        yield Mistake("low", f"{low:g}", f"must be at most high, {high:g}")


@dataclass(frozen=True)
class Part(ConfigTable, key="part", error=DataError, between=(_ordered,)):
    low: float = ruled(Number("mm", at_least=0))
    high: float = ruled(Number("mm", at_most=9), 5.0)
    name: str = ruled(Text(), "")


def _all_below(parts: tuple[Part | None, ...], limit: float) -> Iterator[Mistake]:
    for number, each in enumerate(parts, start=1):
        if each and each.high > limit:
            yield Mistake(f"part {number}.high", f"{each.high:g}", f"must be at most {limit:g}")


@dataclass(frozen=True, kw_only=True)
class Whole(ConfigTable, error=DataError, schema="test/1", between=(_all_below,)):
    limit: float = ruled(Number(above=0))
    count: int = ruled(Integer(1, 9, odd=True), 1)
    sign: int = ruled(Sign(), 1)
    flag: bool = ruled(Flag(), False)
    colour: Colour = ruled(Choice(Colour), Colour.RED)
    pair: tuple[float, float] = ruled(Pair(Number()), (0.0, 1.0))
    unit: tuple[float, ...] = ruled(Numbers(3, unit_length=True), (1.0, 0.0, 0.0))
    words: tuple[str, ...] = ruled(Texts(), ())
    maybe: float | None = ruled(Maybe(Number()), None)
    main: Part = ruled(Subtable(Part), Part(1))
    parts: tuple[Part, ...] = ruled(TableList(Part, 5), (), key="part")
    kind: Rule = ruled(Choice({"text": Text(), "number": Number()}))
    value: object = ruled(Given("kind", lambda kind: Keyed({"it": kind}, {"it": "the value"})))
    parents: tuple[Parent, ...] = ruled(ParentList(), (), key="parent")


GOOD: dict[str, Any] = {"schema": "test/1", "limit": 9.0, "kind": "number", "value": {"it": 3}}

WRONG: dict[str, tuple[Any, str, str]] = {
    "limit": (0, "limit", "must be a finite number above 0"),
    "count": (2, "count", "must be an odd whole number from 1 to 9"),
    "sign": (0, "sign", "must be 1 or -1"),
    "flag": (1, "flag", "must be true or false"),
    "colour": ("greem", "colour", 'must be one of "red", "green"; did you mean "green"?'),
    "pair": ([1], "pair", "must be two numbers, [x, y]"),
    "unit": ([1, 1, 0], "unit", "must be of length 1"),
    "words": ("word", "words", "must be a list of texts"),
    "maybe": ("no", "maybe", "must be a finite number"),
    "main": (3, "main", "must be a table, [part]"),
    "part": ([{"low": 1}, {"low": -1, "name": "n"}], 'part 2 ("n").low', "must be a finite number in mm at least 0"),
    "kind": ("texte", "kind", 'must be one of "text", "number"; did you mean "text"?'),
    "value": ({"it": "x"}, "value.it", "must be a finite number"),
    "parent": ([{"name": "x", "digest": "", "sha": "y"}], 'parent 1 ("x").sha', "unknown key"),
    "schema": (
        "test/2",
        "schema",
        'must be "test/1"; it was written by a newer needleplan: install that version',
    ),
    "lmit": (1, "lmit", 'unknown key; did you mean "limit"?'),
}


def mistakes(document: dict[str, Any]) -> list[Mistake]:
    with pytest.raises(DataError) as caught:
        parse_toml(toml_text(document), Whole, "mine.toml")
    assert caught.value.source == "mine.toml"
    return list(caught.value.mistakes)


def test_a_good_document_is_read() -> None:
    found = parse_toml(toml_text(GOOD), Whole)
    assert (found.limit, found.value, found.main) == (9.0, {"it": 3.0}, Part(1.0, 5.0))


@settings(deadline=None)
@given(st.sets(st.sampled_from(sorted(WRONG)), min_size=1))
def test_any_rules_violated_at_once_give_every_mistake(chosen: set[str]) -> None:
    found = mistakes(GOOD | {key: WRONG[key][0] for key in chosen})
    expected = {WRONG[key][1:] for key in chosen - ({"value"} if "kind" in chosen else set())}
    assert {(each.key, each.rule) for each in found} == expected
    assert len(found) == len(expected)


def test_all_rules_violated_at_once_give_every_mistake() -> None:
    found = mistakes(GOOD | {key: value for key, (value, _, _) in WRONG.items()})
    assert {each.key for each in found} == {key for name, (_, key, _) in WRONG.items() if name != "value"}


@settings(deadline=None)
@given(st.sets(st.sampled_from(["limit", "kind", "value"]), min_size=1))
def test_missing_keys_are_named(gone: set[str]) -> None:
    found = mistakes({key: value for key, value in GOOD.items() if key not in gone})
    keys = {"limit": "limit", "kind": "kind", "value": "value.it"}
    assert {each.key for each in found} == {keys[key] for key in gone - ({"value"} if "kind" in gone else set())}
    assert all(each.rule.startswith("is missing") for each in found)


def test_rules_between_fields_are_checked_beside_broken_fields() -> None:
    parts = [{"low": 1, "high": 8}, {"low": -1}, {"low": 4, "high": 3}]
    assert [str(each) for each in mistakes(GOOD | {"limit": 7, "count": 2, "part": parts})] == [
        "count = 2: must be an odd whole number from 1 to 9",
        "part 2.low = -1: must be a finite number in mm at least 0",
        "part 3.low = 4: must be at most high, 3",
        "part 1.high = 8: must be at most 7",
    ]


def test_the_constructor_checks_the_same_rules() -> None:
    with pytest.raises(DataError) as caught:
        Part(-1, 10)
    assert [each.key for each in caught.value.mistakes] == ["part.low", "part.high"]
    assert isinstance(Part(np.int64(3)).low, float)


def test_too_many_tables_and_other_things_than_tables_are_refused() -> None:
    assert "at most 5 tables [[part]], not 6" in str(mistakes(GOOD | {"part": [{"low": 1}] * 6})[0])
    assert "each below its own [[part]]" in str(mistakes(GOOD | {"part": {"low": 1}})[0])


@pytest.mark.parametrize(("wrong", "expected"), [("pathh", "path"), ("Path", "path"), ("zzz", ""), (3, ""), ("", "")])
def test_a_suggestion_needs_a_similar_name(wrong: object, expected: str) -> None:
    assert suggestion(wrong, ["path", "policy"]) == (f'; did you mean "{expected}"?' if expected else "")


@settings(deadline=None)
@given(st.text("abcdefgh_", min_size=4, max_size=12), st.data())
def test_one_slip_is_always_suggested(name: str, data: st.DataObject) -> None:
    place = data.draw(st.integers(0, len(name) - 1))
    assert f'"{name}"' in suggestion(name[:place] + "x" + name[place + 1 :], [name, "0123456789"])


@pytest.mark.parametrize(
    ("rule", "value", "expected"),
    [
        (Number(at_least=1, at_most=2), float("nan"), "must be a finite number at least 1 and at most 2"),
        (Number("mm", finite=False), float("nan"), "must be a number in mm"),
        (Numbers(3), [1, 2, "3"], "each of the 3 must be a finite number"),
        (Texts("sha256:"), ["md5:"], 'must be a list of texts of the form "sha256:..."'),
        (Text(filled=True), "  ", "must not be empty"),
        (Text(), "\ud800", "must be a text of at most 1000 characters"),
        (Choice({"mm": 1}), "mmm", 'must be "mm"'),
        (Keyed({}), 3, "must be a table"),
    ],
)
def test_every_rule_refuses_with_its_sentence(rule: Rule, value: object, expected: str) -> None:
    with pytest.raises(Violation) as caught:
        rule.read(value)
    assert str(caught.value) == expected


def test_numbers_may_be_infinite_if_told() -> None:
    assert Number(finite=False).read(float("inf")) == float("inf")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot be read: No such file"):
        text_of(tmp_path / "none.toml", ModelError)
    with pytest.raises(DataError, match="cannot be read: Is a directory"):
        read_toml(tmp_path, Whole)
    (tmp_path / "latin.toml").write_bytes(b"a = '\xe9'")
    with pytest.raises(DataError, match=r"is not TOML: not UTF-8 at byte 5"):
        read_toml(tmp_path / "latin.toml", Whole)
    (tmp_path / "cut.toml").write_text("a = ")
    with pytest.raises(DataError, match="is not TOML"):
        read_toml(tmp_path / "cut.toml", Whole)
    with pytest.raises(ModelError, match=r'no shipped test of that name \(cut, latin\); did you mean "cut"'):
        text_of("cutt", ModelError, tmp_path, "test")


def test_a_table_is_written_with_its_schema_first_and_without_what_is_absent() -> None:
    raw = raw_of(Whole(limit=9, kind="text", value={"it": "x"}, parts=(Part(1),)))
    assert list(raw)[:2] == ["schema", "limit"]
    assert {"maybe", "parent"} & raw.keys() == set()
    assert raw["part"] == [{"low": 1.0, "high": 5.0, "name": ""}]
