"""Actions and outcomes: equal to their text, with codes in arrays."""

import copy
import json
import pickle

import numpy as np
import pytest

import needleplan as npl
from needleplan.planning import Action, Outcome


@pytest.mark.parametrize("member", [*Action, *Outcome], ids=str)
def test_a_member_equals_its_text_and_is_found_by_text_and_code(member: Action | Outcome) -> None:
    kind = type(member)
    assert member == str(member) == f"{member}" == member.value
    assert {str(member): 1}[member] == 1
    assert kind(str(member)) is kind(member.code) is kind(np.uint8(member.code)) is member
    assert pickle.loads(pickle.dumps(member)) is copy.deepcopy(member) is member
    assert json.loads(json.dumps(member)) == str(member)


def test_arrays_of_codes_compare_element_by_element() -> None:
    actions = np.array([0, 1, 2, 1], dtype=np.uint8)
    np.testing.assert_array_equal(actions == Action.ROTATE, [False, True, False, True])
    np.testing.assert_array_equal(actions != Action.ROTATE, [True, False, True, False])
    assert [action == Action.ROTATE for action in actions] == [False, True, False, True]
    assert [action == Action.ROTATE for action in actions.tolist()] == [False, True, False, True]
    np.testing.assert_array_equal(np.array(["target", "exit"]) == Outcome.TARGET, [True, False])
    assert np.str_("target") == Outcome.TARGET != "exit"


@pytest.mark.parametrize("other", [7, True, "rotate!", None])
def test_there_is_no_other_member(other: object) -> None:
    with pytest.raises(ValueError, match="is not a valid Action"):
        Action(other)


def test_answers_compare_with_texts(table: npl.PolicyTable) -> None:
    entry = table.best_entry()
    path, rollouts = table.path(entry), table.rollout(entry, runs=500)
    assert path.outcome == "target"
    assert rollouts.outcomes["target"] == rollouts.success * 500
    assert sum(rollouts.outcomes.values()) == 500
    assert table.lookup(entry).action in ("insert", "rotate, then insert")
    assert table.policy.dtype == path.actions.dtype == np.uint8
