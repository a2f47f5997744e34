"""All contestants of `compare_peers.py`, in the order of its table."""

import ours
import peers
from contest import Contestant, Prepare, Solve, serve
from problem import Problem

PARTITIONS = ((6, 4), (12, 8), (24, 16))
PRIORITIES = ("H1", "H2")


def _by_hand(kernel: str) -> Prepare:
    """Return the `prepare` of a numba kernel; numba is imported only in the process that runs it."""

    def prepare(problem: Problem) -> Solve:
        import by_hand

        return by_hand.prepare(kernel)(problem)

    return prepare


LATTICE = Contestant("lattice-1", "needleplan lattice, 1 thread", ours.lattice(1), repeats=25, warm_up=3)

OURS = (
    LATTICE,
    Contestant("lattice-2", "needleplan lattice, 2 threads", ours.lattice(2), repeats=25, warm_up=3),
    *(
        Contestant(
            f"strips-{threads}",
            f"needleplan lattice, PPVI on strips, {threads} thread{'s'[: threads - 1]}",
            ours.lattice(threads, "ppvi", priority="bound"),
            repeats=25,
            warm_up=3,
        )
        for threads in (1, 2)
    ),
    Contestant("whole-way", "needleplan, scenario file to table", ours.whole_way, repeats=9, warm_up=1),
    Contestant("tabular-1", "needleplan tabular, 1 thread", ours.tabular(1), repeats=5, warm_up=1),
    Contestant("tabular-2", "needleplan tabular, 2 threads", ours.tabular(2), repeats=5, warm_up=1),
    Contestant(
        "tabular-arrays", "needleplan tabular, arrays to values", ours.tabular_from_arrays, repeats=3, warm_up=1
    ),
    Contestant("tabular-vi", "needleplan tabular, plain value iteration", ours.tabular(None, "vi")),
)

BY_HAND = (
    Contestant(
        "numba-gs", "numba, alternating Gauss-Seidel, 1 thread", _by_hand("alternating"), "numba", repeats=5, warm_up=1
    ),
    Contestant("numba-jacobi", "numba, Jacobi, all threads", _by_hand("jacobi"), "numba", repeats=3, warm_up=1),
)

PEERS = (
    Contestant(
        "quantecon-mpi",
        "QuantEcon DiscreteDP, modified policy iteration",
        peers.quantecon("modified_policy_iteration"),
        "quantecon",
        repeats=2,
        warm_up=1,
    ),
    Contestant(
        "quantecon-vi",
        "QuantEcon DiscreteDP, value iteration",
        peers.quantecon("value_iteration"),
        "quantecon",
        repeats=2,
        warm_up=1,
    ),
    Contestant(
        "mdptoolbox", "pymdptoolbox, value iteration", peers.mdptoolbox, "mdptoolbox", repeats=2, note="patched"
    ),
    Contestant("mdpsolver-vi", "mdpsolver, value iteration, 1 thread", peers.mdpsolver("vi"), "mdpsolver"),
    Contestant(
        "mdpsolver-vi-all", "mdpsolver, value iteration, all threads", peers.mdpsolver("vi", parallel=True), "mdpsolver"
    ),
    Contestant("mdpsolver-mpi", "mdpsolver, modified policy iteration, 1 thread", peers.mdpsolver("mpi"), "mdpsolver"),
    Contestant("mdpsolver-gs", "mdpsolver, Gauss-Seidel", peers.mdpsolver("vi", "gs"), "mdpsolver"),
    Contestant("storm", "storm (stormpy), value iteration", peers.storm, "stormpy", repeats=2),
)

THESIS = (
    Contestant("plain", "plain value iteration, 1 thread", ours.lattice(1, "vi")),
    *(
        Contestant(
            f"ppvi-{px}x{py}-{priority}",
            f"PPVI, {px} x {py} partitions, {priority}",
            ours.lattice(1, "ppvi", (px, py), priority),
        )
        for px, py in PARTITIONS
        for priority in PRIORITIES
    ),
)

CONTESTANTS = {each.name: each for each in (*OURS, *BY_HAND, *PEERS, *THESIS)}


if __name__ == "__main__":
    serve(CONTESTANTS)
