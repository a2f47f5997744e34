//! Error bounds that hold: every solver, stopped anywhere, on random problems, against exact solutions.

mod cases;

use std::ops::ControlFlow;

use cases::exact::{fixed_point, optimum};
use cases::random::{self, Random};
use cases::{Rows, tabular};
use ppvi::lattice::evaluation::{self, OptimalValues};
use ppvi::lattice::{LatticeMdp, Motion, STRAIGHT, outcome, sweep, sweep::LatticeSolution};
use ppvi::{
    Mdp, Order, Partition, PrioritizedOptions, Priority, Progress, Report, Status, StopRule, Storage, TabularMdp,
    prioritized, proper_states, tabular_sweep, value_iteration,
};

/// Cases of each kind of problem in the fast set.
const FEW: u64 = 40;

/// Cases of each kind of problem in the slow set, half a minute's work; `PPVI_BOUND_CASES=3400` with `--release` repeats the
/// longer study.
fn many() -> u64 {
    std::env::var("PPVI_BOUND_CASES").map_or(200, |text| text.parse().expect("PPVI_BOUND_CASES is a whole number"))
}

/// What a solver returned, with its values in the precision in which they are kept.
struct Outcome {
    solver: &'static str,
    values: Vec<f64>,
    report: Report,
}

/// Where a solve is stopped.
#[derive(Debug)]
struct Stop {
    rule: StopRule,
    /// The number of the call of the observer that stops the solve.
    call: Option<u64>,
}

impl Stop {
    fn random(random: &mut Random) -> Self {
        let mut rule = StopRule::new(random.scale(1e-12, 10.0)).unwrap();
        rule.max_sweeps = if random.chance(60) { 1 + random.below(30) as u64 } else { 3000 };
        Stop { rule, call: random.chance(25).then(|| 1 + random.below(20) as u64) }
    }

    fn observed<R>(&self, solve: impl FnOnce(Option<ppvi::Observer>) -> ppvi::Result<R>) -> R {
        let mut calls = 0;
        let mut observe = |_: &Progress| {
            calls += 1;
            if Some(calls) == self.call { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        solve(Some(&mut observe)).unwrap()
    }
}

/// Whether a number is above a bound, or is no number.
fn exceeds(number: f64, bound: f64) -> bool {
    number.is_nan() || number > bound
}

/// Checks every statement that a report makes. Returns the violation, if there is one.
fn violation(outcome: &Outcome, exact: &[Vec<f64>], tolerance: f64) -> Option<String> {
    let Outcome { solver, values, report } = outcome;
    if report.status == Status::Converged && exceeds(report.error_bound, tolerance) {
        return Some(format!("{solver}: converged, but the bound is {} > {tolerance}", report.error_bound));
    }
    if report.error_bound.is_nan() || report.residual.is_nan() {
        return Some(format!("{solver}: {report:?}"));
    }
    for exact in exact {
        for (state, (value, want)) in values.iter().zip(exact).enumerate() {
            let error = ppvi::bellman::change(*value, *want);
            // The exact solution is rounded to double precision.
            if exceeds(error, report.error_bound + 4.0 * f64::EPSILON * want.abs()) {
                return Some(format!("{solver}: state {state} is {value}, exactly {want}; {report:?}"));
            }
        }
    }
    None
}

fn labels(random: &mut Random, states: usize) -> Partition {
    let count = 1 + random.below(6);
    Partition::from_labels((0..states).map(|_| random.below(count) as u32).collect(), count).unwrap()
}

fn tabular_case(seed: u64) -> Option<Vec<Option<String>>> {
    let mut random = Random(seed);
    let (rows, discount) = random::rows(&mut random);
    let Ok(mdp) = tabular(&rows, discount) else { return None };
    let proper = if discount < 1.0 { vec![true; rows.len()] } else { proper_states(&mdp) };
    let exact = [false, true].map(|normalized| optimum(&rows, discount, &proper, normalized));
    let exact: Vec<Vec<f64>> = exact.into_iter().collect::<Option<_>>()?;
    let stop = Stop::random(&mut random);
    let outcome =
        |solver, solution: ppvi::Solution| Outcome { solver, values: solution.values, report: solution.report };
    let mut outcomes = vec![
        outcome("value_iteration", stop.observed(|observer| value_iteration(&mdp, stop.rule, observer))),
        outcome("tabular_sweep", stop.observed(|observer| tabular_sweep(&mdp, stop.rule, observer))),
    ];
    for priority in [Priority::H1, Priority::H2, Priority::Bound] {
        let options = PrioritizedOptions { priority, inner_sweeps: 1 + random.next() % 4, ..Default::default() };
        let partition = labels(&mut random, mdp.states());
        let solve = |observer: Option<ppvi::Observer>| prioritized(&mdp, &partition, options, stop.rule, observer);
        outcomes.push(outcome("prioritized", stop.observed(solve)));
    }
    Some(outcomes.iter().map(|outcome| violation(outcome, &exact, stop.rule.tolerance)).collect())
}

/// The rows of a lattice; the tabular problem may have one state more, in which executions end.
fn rows_of(mdp: &TabularMdp) -> Rows {
    let row = |row| {
        let (successors, probabilities, cost) = mdp.row(row);
        (cost, successors.iter().copied().zip(probabilities.iter().copied()).collect())
    };
    (0..mdp.states()).map(|state| mdp.rows(state).map(row).collect()).collect()
}

fn lattice_case(seed: u64) -> Option<Vec<Option<String>>> {
    let mut random = Random(seed);
    let lattice = random::lattice(&mut random).unwrap();
    let (rows, discount) = (rows_of(&TabularMdp::from_mdp(&lattice).unwrap()), lattice.discount());
    let proper = match discount < 1.0 {
        true => vec![true; rows.len()],
        false => proper_states(&TabularMdp::from_mdp(&lattice).unwrap()),
    };
    let exact: Vec<Vec<f64>> = vec![optimum(&rows, discount, &proper, false)?];
    let stop = Stop::random(&mut random);
    let swept = stop.observed(|observer| sweep::solve(&lattice, stop.rule, observer));
    let rule = StopRule { storage: Storage::Single, ..stop.rule };
    let narrow = |solution: ppvi::Solution| {
        (solution.values.iter().map(|value| f64::from(*value as f32)).collect(), solution.report)
    };
    let (iterated, report) = narrow(stop.observed(|observer| value_iteration(&lattice, rule, observer)));
    let of_lattice = |solver, solved: LatticeSolution| {
        let values = solved.values.into_iter().map(f64::from).collect();
        Outcome { solver, values, report: solved.report }
    };
    let strips = stop.observed(|observer| sweep::prioritized(&lattice, [1, 1], stop.rule, observer));
    let mut outcomes = vec![
        of_lattice("sweep", swept),
        of_lattice("sweep::prioritized", strips),
        Outcome { solver: "value_iteration", values: iterated, report },
    ];
    let partition = lattice.partition([1, 1]).unwrap();
    let options = PrioritizedOptions {
        priority: random.one_of(&[Priority::H1, Priority::H2, Priority::Bound]),
        ..Default::default()
    };
    let solve = |observer: Option<ppvi::Observer>| prioritized(&lattice, &partition, options, rule, observer);
    let (values, report) = narrow(stop.observed(solve));
    outcomes.push(Outcome { solver: "prioritized", values, report });
    Some(outcomes.iter().map(|outcome| violation(outcome, &exact, stop.rule.tolerance)).collect())
}

/// The exact probability that a policy reaches the target.
fn exact_success(lattice: &LatticeMdp, policy: &[u8]) -> Option<Vec<f64>> {
    let by_motion: Vec<Vec<u8>> = lattice.parts().motions().iter().map(|m| lattice.outcome_table(*m)).collect();
    let codes = &by_motion[Motion::Curved as usize];
    let ends_at_target = |state: usize, action: u8| match action {
        STRAIGHT => by_motion[Motion::Straight as usize][state] == outcome::TARGET,
        _ => codes[state ^ usize::from(action)] == outcome::TARGET,
    };
    let chain: Vec<(f64, Vec<(usize, f64)>)> = (0..lattice.states())
        .map(|state| match codes[state] {
            outcome::AT_TARGET => (1.0, Vec::new()),
            outcome::AT_OBSTACLE => (0.0, Vec::new()),
            _ => {
                let (action, mut row) = (policy[state], Vec::new());
                lattice.for_each_successor(state, usize::from(action), |next, p| row.push((next, p)));
                (f64::from(u8::from(ends_at_target(state, action))), row)
            }
        })
        .collect();
    // States that cannot reach the target would make the system singular.
    let mut reaches: Vec<bool> = chain.iter().map(|(target, _)| *target > 0.0).collect();
    while let Some(state) =
        (0..chain.len()).find(|s| !reaches[*s] && chain[*s].1.iter().any(|(next, _)| reaches[*next]))
    {
        reaches[state] = true;
    }
    let target: Vec<f64> = chain.iter().map(|(target, _)| *target).collect();
    let rows = chain.into_iter().enumerate().map(|(state, (_, row))| {
        row.into_iter().filter(|(next, _)| reaches[state] && reaches[*next]).collect::<Vec<_>>()
    });
    fixed_point(&rows.collect::<Vec<_>>(), &target)
}

fn success_case(seed: u64) -> Option<Vec<Option<String>>> {
    let mut random = Random(seed);
    let lattice = random::lattice(&mut random).unwrap();
    let stop = Stop::random(&mut random);
    let solved = stop.observed(|observer| sweep::solve(&lattice, stop.rule, observer));
    let optimal = OptimalValues { values: &solved.values, residual: solved.report.residual };
    let any: Vec<u8> = (0..lattice.states()).map(|_| random.below(2) as u8).collect();
    let mut results = Vec::new();
    for (policy, optimal) in [(&solved.policy, Some(optimal)), (&solved.policy, None), (&any, None)] {
        let exact = exact_success(&lattice, policy)?;
        let success = evaluation::success_from(&lattice, policy, Order::Linear, optimal).unwrap();
        let bound = evaluation::success_error(&lattice, policy, Order::Linear, &success, optimal).unwrap();
        let error = exact
            .iter()
            .zip(&success.values)
            .map(|(p, found)| (p - f64::from(*found)).abs())
            .fold(0.0, ppvi::bellman::larger);
        results.push(exceeds(error, bound).then(|| format!("success is off by {error}, bound {bound}")));
        // Cubic interpolation from two starts.
        let cubic = [optimal, None].map(|start| {
            let success = evaluation::success_from(&lattice, policy, Order::Cubic, start).unwrap();
            let bound = evaluation::success_error(&lattice, policy, Order::Cubic, &success, None).unwrap();
            (success, bound)
        });
        let error = cubic[0].0.values.iter().zip(&cubic[1].0.values).map(|(a, b)| f64::from((a - b).abs()));
        let (error, bound) = (error.fold(0.0, ppvi::bellman::larger), cubic[0].1 + cubic[1].1);
        results.push(exceeds(error, bound).then(|| format!("cubic success is off by {error}, bound {bound}")));
    }
    Some(results)
}

/// Runs the cases with these seeds, and fails with the first violations.
fn check(name: &str, seeds: std::ops::Range<u64>, case: impl Fn(u64) -> Option<Vec<Option<String>>>) {
    let (mut solves, mut skipped, mut violations) = (0, 0, Vec::new());
    for seed in seeds {
        let Some(found) = case(seed) else {
            skipped += 1;
            continue;
        };
        solves += found.len();
        violations.extend(found.into_iter().flatten().map(|text| format!("seed {seed}: {text}")));
    }
    println!("{name}: {} violations in {solves} solves, {skipped} cases skipped", violations.len());
    assert!(violations.is_empty(), "{}\n{}", violations.len(), violations[..violations.len().min(12)].join("\n"));
}

#[test]
fn bounds_of_random_tables_hold() {
    check("tabular", 0..FEW, tabular_case);
}

#[test]
fn a_solve_ends_whose_values_were_larger_on_the_way() {
    check("tabular", 859..860, tabular_case);
}

#[test]
fn bounds_of_random_lattices_hold() {
    check("lattice", 0..FEW, lattice_case);
}

#[test]
fn bounds_of_success_probabilities_hold() {
    check("success", 0..FEW, success_case);
}

#[test]
#[ignore = "slow: `make studies` runs it"]
fn bounds_of_many_success_probabilities_hold() {
    check("success", FEW..FEW + many(), success_case);
}

#[test]
#[ignore = "slow: `make studies` runs it"]
fn bounds_of_many_random_tables_hold() {
    check("tabular", FEW..FEW + many(), tabular_case);
}

#[test]
#[ignore = "slow: `make studies` runs it"]
fn bounds_of_many_random_lattices_hold() {
    check("lattice", FEW..FEW + many(), lattice_case);
}
