"""Planning in a forked process: a fork copies the memory of the solver, but not its threads."""

import multiprocessing
import os
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection

import pytest

import needleplan as npl
from needleplan.scenario import Grid, Method, Scenario

LIMIT_S = 60

pytestmark = [
    pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="this system cannot fork"),
    # Python 3.12 and newer warn in the parent, whose solver threads are still there.
    pytest.mark.filterwarnings("ignore:This process .* is multi-threaded, use of fork:DeprecationWarning"),
]


def answers(scenario: Scenario) -> dict[str, bytes]:
    """Everything that runs on the solver's threads."""
    table = npl.plan(scenario)
    start = table.best_entry().pose
    problem = npl.mdp.TabularMdp.from_rows(**table.lattice.tabular())
    return {
        "values": table.values.tobytes(),
        "policy": table.policy.tobytes(),
        "success": table.success.tobytes(),
        "expected length": table.expectations().length_mm.tobytes(),
        "decisions": table.lookup_many([start] * 300).value.tobytes(),
        "outcomes": repr(table.rollout(start, runs=300, seed=1).outcomes).encode(),
        "tabular": npl.mdp.solve(problem, tolerance=0.1).values.tobytes(),
    }


def in_a_fork(scenario: Scenario) -> dict[str, bytes]:
    """The answers of a process forked from this one."""
    return forked(answers, scenario)


def with_one_thread(scenario: Scenario) -> dict[str, bytes]:
    """The answers given in every call of a progress callback, on a pool of one thread."""
    os.environ["RAYON_NUM_THREADS"] = "1"
    found: list[dict[str, bytes]] = []
    npl.plan(scenario, lambda *_: found.append(answers(scenario)))
    assert all(each == found[0] for each in found)
    return found[0]


def forked(work: Callable[[Scenario], dict[str, bytes]], scenario: Scenario) -> dict[str, bytes]:
    """What `work` returns in a forked process, which must not keep its parent waiting."""

    def send(answer: Connection) -> None:
        answer.send(work(scenario))

    context = multiprocessing.get_context("fork")
    received, answer = context.Pipe(duplex=False)
    child = context.Process(target=send, args=(answer,))
    child.start()
    answer.close()
    try:
        assert received.poll(LIMIT_S), "the forked process does not answer"
        return received.recv()
    finally:
        child.kill()
        child.join()


@pytest.fixture(scope="module")
def scene(small: Scenario) -> Scenario:
    return replace(small, grid=Grid((4, 4)))


@pytest.mark.slow
@pytest.mark.parametrize(("method", "threads"), [*((method, None) for method in Method), (Method.SWEEP, 2)])
def test_a_forked_process_plans_as_its_parent_does(scene: Scenario, method: Method, threads: int | None) -> None:
    scene = replace(scene, solver=replace(scene.solver, method=method, tolerance=0.1, threads=threads))
    before = answers(scene)
    assert forked(answers, scene) == before
    assert answers(scene) == before


@pytest.mark.slow
def test_so_does_a_process_forked_from_one_that_has_not_planned(scene: Scenario) -> None:
    assert forked(in_a_fork, scene) == answers(scene)


@pytest.mark.slow
def test_a_progress_callback_may_plan_where_there_is_only_one_thread(scene: Scenario) -> None:
    assert forked(with_one_thread, scene) == answers(scene)
