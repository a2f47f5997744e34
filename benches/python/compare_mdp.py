"""Compare `npl.mdp.solve` with the solvers of other projects on fifteen sparse MDPs, in one run.

Every solver gets every problem in a process of its own, and a tolerance of 1e-5 times the largest value: the error that
its own stop rule promises. The error of its values is then bounded by their Bellman residual, on the same arrays. Times
are processor times of the call that solves (all threads), best of the runs within a second
after one that is not timed; the build is separate.

    python benches/python/compare_mdp.py --json mdp.json > mdp.md
    python benches/python/compare_mdp.py --only forest
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import machine
import numpy as np
from mdp_problems import PROBLEMS, Floats, Tabular, ours
from scipy import sparse

from needleplan import mdp

_MARK = "RESULT "

# Wanted error, relative to the largest value.
_ERROR = 1e-5

# A result counts if the bound of its error is at most this multiple of the wanted error.
_SLACK = 2.0

# Seconds in which a solve is repeated.
_REPEAT_S = 1.0

Run = Callable[[], Floats]


def needleplan(problem: Tabular, tolerance: float) -> Run:
    """Our default method."""
    process = ours(problem)
    return lambda: mdp.solve(process, tolerance=tolerance).values


def quantecon(method: str) -> Callable[[Tabular, float], Run]:
    """QuantEcon.py: state-action pairs, one scipy matrix."""

    def prepare(problem: Tabular, tolerance: float) -> Run:
        from quantecon.markov import DiscreteDP

        states, actions = problem.costs.shape
        rows = sparse.vstack(problem.transitions).tocsr()
        order = (np.arange(actions)[None, :] * states + np.arange(states)[:, None]).ravel()
        pairs = np.arange(states * actions)
        matrix = sparse.csr_matrix(rows[order])
        process = DiscreteDP(-problem.costs.ravel(), matrix, problem.discount, pairs // actions, pairs % actions)
        return lambda: -process.solve(method=method, epsilon=2 * tolerance, max_iter=1_000_000).v

    return prepare


def mdpsolver(algorithm: str) -> Callable[[Tabular, float], Run]:
    """`mdpsolver`: nested lists; a second solve starts from the values of the first, so there is one run."""

    def prepare(problem: Tabular, tolerance: float) -> Run:
        from mdpsolver import model as new_model

        states = len(problem.costs)
        spans = [[(m.indptr[s], m.indptr[s + 1]) for m in problem.transitions] for s in range(states)]
        parts = [(m.data.tolist(), m.indices.tolist()) for m in problem.transitions]
        chances, columns = (
            [[part[kind][a:b] for part, (a, b) in zip(parts, span, strict=True)] for span in spans] for kind in (0, 1)
        )
        model = new_model()
        rewards = (-problem.costs).tolist()
        model.mdp(discount=problem.discount, rewards=rewards, tranMatProbs=chances, tranMatColumns=columns)

        def solve() -> Floats:
            model.solve(algorithm=algorithm, tolerance=tolerance)
            return -np.array(model.getValueVector())

        return solve

    return prepare


def mdptoolbox(solver: str) -> Callable[[Tabular, float], Run]:
    """`pymdptoolbox`; its bound of the iterations, which takes minutes, is replaced by a fixed limit."""

    def prepare(problem: Tabular, tolerance: float) -> Run:
        from mdptoolbox import mdp as toolbox
        from mdptoolbox import util

        util.isStochastic = util.isNonNegative = lambda _matrix: True
        toolbox.ValueIteration._boundIter = lambda self, _epsilon: setattr(self, "max_iter", 1_000_000)
        matrices = [sparse.csr_matrix(m) for m in problem.transitions]

        def solve() -> Floats:
            options = {"epsilon": tolerance, "max_iter": 1_000_000}
            made = getattr(toolbox, solver)(matrices, -problem.costs, problem.discount, **options)
            made.run()
            # Its rule bounds the span of the error; the middle of the bounds is given to it.
            values = -np.array(made.V)
            change = backup(problem, values) - values
            return values + (change.min() + change.max()) / 2 / (1 - problem.discount)

        return solve

    return prepare


def storm(problem: Tabular, tolerance: float) -> Run:
    """`stormpy` 2: discounted total cost by value iteration."""
    import stormpy
    from stormpy import environments, models
    from stormpy.datastructures import SparseMatrixBuilder

    states, actions = problem.costs.shape
    rows = sparse.vstack(problem.transitions).tocsr()
    matrix = rows[(np.arange(actions)[None, :] * states + np.arange(states)[:, None]).ravel()]
    matrix.sort_indices()
    numbers = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    builder = SparseMatrixBuilder[float](
        rows=matrix.shape[0], columns=states, entries=matrix.nnz, has_custom_row_grouping=True, row_groups=states
    )
    groups = list(range(0, matrix.shape[0], actions))
    builder.add_next_values(numbers.tolist(), matrix.indices.tolist(), matrix.data.tolist(), groups)
    labeling = models.StateLabeling(states)
    labeling.add_label("init")
    labeling.add_label_to_state("init", 0)
    costs = models.SparseRewardModel[float](optional_state_action_reward_vector=problem.costs.ravel().tolist())
    parts = models.SparseModelComponents[float](
        transition_matrix=builder.build(), state_labeling=labeling, reward_models={"cost": costs}
    )
    process = models.SparseMdp[float](parts)
    formula = stormpy.parse_properties(f'R{{"cost"}}min=? [ Cdiscount={problem.discount} ]')[0]
    environment = environments.Environment()
    environment.solver().min_max().method = environments.MinMaxMethod.VALUE_ITERATION
    environment.solver().min_max().precision = stormpy.Rational(f"{tolerance:.12f}")
    environment.solver().min_max().relative_termination_criterion = False
    check = stormpy.model_checking
    return lambda: np.array(check(process, formula, environment=environment).get_value_vector())


SOLVERS: dict[str, Callable[[Tabular, float], Run]] = {
    "needleplan": needleplan,
    "quantecon-mpi": quantecon("modified_policy_iteration"),
    "quantecon-pi": quantecon("policy_iteration"),
    "mdpsolver-mpi": mdpsolver("mpi"),
    "pymdptoolbox-mpi": mdptoolbox("PolicyIterationModified"),
    "storm-vi": storm,
}


def backup(problem: Tabular, values: Floats) -> Floats:
    """Return the values after one application of the Bellman operator."""
    q = [problem.costs[:, a] + problem.discount * (m @ values) for a, m in enumerate(problem.transitions)]
    return np.min(q, axis=0)


def compete(name: str, solver: str) -> dict[str, Any]:
    """Build and solve a problem with a solver; return times and the bound of the error over the wanted error."""
    problem = PROBLEMS[name]()
    scale = float(np.abs(mdp.solve(ours(problem), tolerance=1e-3).values).max())
    tolerance = _ERROR * scale
    began = process_time()
    run = SOLVERS[solver](problem, tolerance)
    build = process_time() - began
    if solver != "mdpsolver-mpi":
        run()  # compilation
    times, started = [], perf_counter()
    while not times or (perf_counter() - started < _REPEAT_S and solver != "mdpsolver-mpi"):
        began = process_time()
        values = run()
        times.append(process_time() - began)
    residual = float(np.abs(backup(problem, values) - values).max())
    return {
        "build_s": build,
        "solve_s": min(times),
        "runs": len(times),
        "bound": residual / (1 - problem.discount) / tolerance,
    }


def measure(name: str, solver: str, limit_s: float) -> dict[str, Any]:
    """Return the result of `compete` in a process of its own, or the reason why there is none."""
    command = [sys.executable, str(Path(__file__).resolve()), "--compete", name, solver]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit_s, check=False)
    except subprocess.TimeoutExpired:
        return {"failure": f"over {limit_s:.0f} s"}
    for line in done.stdout.splitlines():
        if line.startswith(_MARK):
            result: dict[str, Any] = json.loads(line.removeprefix(_MARK))
            if result["bound"] > _SLACK:
                result["failure"] = f"error bound {result['bound']:.1g} times the wanted error"
            return result
    return {"failure": (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1][:120]}


def text(record: dict[str, Any]) -> str:
    """Return the report: a table of processor times, and the ratios."""
    about = record["machine"]
    packages = ", ".join(f"{name} {version}" for name, version in about["packages"].items())
    lines = [
        f"{about['processor']}, {about['threads']} threads, load {about['load_before']} before the run; "
        f"{about['date'][:10]}, commit {about['commit']}, Python {about['python']}, {packages}.",
        "",
        "| problem | needleplan s | best peer | its s | ratio |",
        "|---|--:|---|--:|--:|",
    ]
    ratios = []
    for name, results in record["results"].items():
        mine = results["needleplan"]
        peers = {solver: r["solve_s"] for solver, r in results.items() if solver != "needleplan" and "failure" not in r}
        if "failure" in mine or not peers:
            lines.append(f"| {name} | {mine.get('failure', mine.get('solve_s'))} | none at the wanted error | | |")
            continue
        best = min(peers, key=lambda solver: peers[solver])
        ratios.append(peers[best] / mine["solve_s"])
        lines.append(f"| {name} | {mine['solve_s']:.3g} | {best} | {peers[best]:.3g} | {ratios[-1]:.2g} |")
    if ratios:
        mean = float(np.exp(np.mean(np.log(ratios))))
        slower = sum(ratio < 1 / 1.2 for ratio in ratios)
        lines += [
            "",
            f"Geometric mean of {len(ratios)} ratios: {mean:.3g}. Slower than 1.2 times the best peer: {slower}.",
        ]
    lines += ["", "| problem | " + " | ".join(SOLVERS) + " |", "|---|" + "--:|" * len(SOLVERS)]
    for name, results in record["results"].items():
        cells = [results[s].get("failure") or f"{results[s]['solve_s']:.3g}" for s in SOLVERS if s in results]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Run all solvers on all problems, and print the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", metavar="TEXT", help="problems whose name holds this text")
    parser.add_argument("--time-limit", type=float, default=60.0, metavar="S", help="for each solver and problem")
    parser.add_argument("--processes", type=int, default=1, metavar="N", help="solvers at a time (default 1)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all measured values")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="print the report of a file that --json wrote")
    parser.add_argument("--compete", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.compete:
        print(_MARK + json.dumps(compete(*options.compete)), flush=True)
        return
    if options.markdown:
        print(text(json.loads(options.markdown.read_text(encoding="utf-8"))))
        return
    record: dict[str, Any] = {"machine": machine.description(), "error": _ERROR, "results": {}}
    names = [name for name in PROBLEMS if options.only in name]
    with ThreadPoolExecutor(options.processes) as pool:
        jobs = {
            name: {solver: pool.submit(measure, name, solver, options.time_limit) for solver in SOLVERS}
            for name in names
        }
        for name in names:
            record["results"][name] = {solver: job.result() for solver, job in jobs[name].items()}
            print(name, record["results"][name], file=sys.stderr, flush=True)
    if options.json:
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print(text(record))


if __name__ == "__main__":
    main()
