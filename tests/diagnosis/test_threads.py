"""A diagnosis uses one thread of BLAS: more threads make it slower, and its last digits depend on their number."""

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from needleplan.diagnosis import Library, _next_motion, diagnose, next_trials
from needleplan.diagnosis._threads import one_thread
from needleplan.models.effects import effect_named
from tests.diagnosis.trials import BASE, recordings


def threads() -> set[int]:
    """Return the numbers of threads of all BLAS libraries of this process."""
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


@pytest.mark.slow
def test_a_diagnosis_has_one_thread_of_blas_and_gives_the_others_back(monkeypatch: pytest.MonkeyPatch) -> None:
    during: list[set[int]] = []

    def limits(_: object) -> None:
        during.append(threads())

    with threadpool_limits(limits=2, user_api="blas"):
        few = Library([effect_named("viscous")], BASE)
        found = diagnose(BASE, recordings(), library=few, progress=limits)
        assert threads() == {2}
        stages = len(during)
        monkeypatch.setattr(_next_motion, "recorded_limits", limits)
        next_trials(found)
        assert threads() == {2}
    assert len(during) > stages > 0
    assert all(each == {1} for each in during)


def test_the_threads_are_given_back_after_an_error() -> None:
    @one_thread
    def fails() -> None:
        assert threads() == {1}
        raise ValueError("an error")

    with threadpool_limits(limits=2, user_api="blas"):
        with pytest.raises(ValueError, match="an error"):
            fails()
        assert threads() == {2}
