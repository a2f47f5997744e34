//! Random problems: all solvers against each other, data structures against naive ones, and invalid input.

mod cases;

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::time::Duration;

use cases::{Rows, brute_force, chain, grid_world, random_rows, tabular};
use ppvi::bellman::change;
use ppvi::queue::IndexedMaxQueue;
use ppvi::{
    Dependencies, Error, Evaluation, Mdp, Partition, PrioritizedOptions, Priority, Progress, Solution, StateDependents,
    Status, StopRule, TabularMdp, policy_iteration, prioritized, proper_states, tabular_sweep, value_iteration,
};
use proptest::prelude::*;

const METRICS: [Priority; 3] = [Priority::H1, Priority::H2, Priority::Bound];

/// The exact residual, computed independently of the solvers.
fn residual(mdp: &TabularMdp, values: &[f64]) -> f64 {
    (0..mdp.states()).map(|state| change(mdp.backup(state, values).0, values[state])).fold(0.0, f64::max)
}

fn check_solution(mdp: &TabularMdp, tolerance: f64, solution: &Solution) {
    let report = &solution.report;
    assert_eq!(report.status, Status::Converged);
    assert_eq!(report.residual, residual(mdp, &solution.values), "the residual reported is the exact one");
    assert!(report.error_bound <= tolerance, "{report:?}");
    for state in 0..mdp.states() {
        assert_eq!(solution.policy[state] as usize, mdp.backup(state, &solution.values).1, "greedy at {state}");
    }
}

/// Checks that all solvers agree within the sum of their error bounds.
fn check_agreement(mdp: &TabularMdp, partition: &Partition, tolerance: f64, inner_sweeps: u64) {
    let rule = StopRule::new(tolerance).unwrap();
    let reference = value_iteration(mdp, rule, None).unwrap();
    check_solution(mdp, tolerance, &reference);
    let mut others = vec![tabular_sweep(mdp, rule, None).unwrap()];
    for evaluation in [Evaluation::Auto, Evaluation::Sweeps, Evaluation::Solve] {
        others.push(policy_iteration(mdp, evaluation, None, rule, None).unwrap());
    }
    for priority in METRICS {
        let options = PrioritizedOptions { priority, inner_sweeps, ..PrioritizedOptions::default() };
        others.push(prioritized(mdp, partition, options, rule, None).unwrap());
    }
    for other in &others {
        check_solution(mdp, tolerance, other);
        let bound = reference.report.error_bound + other.report.error_bound;
        for (state, (a, b)) in reference.values.iter().zip(&other.values).enumerate() {
            assert!(change(*a, *b) <= bound, "state {state}: {a} and {b}, bound {bound}");
        }
    }
}

/// Labels drawn from `seed` for `states` states.
fn partition(states: usize, partitions: usize, seed: usize) -> Partition {
    let labels = (0..states).map(|s| ((s + seed).wrapping_mul(0x9E37_79B9) >> 7) as u32 % partitions as u32);
    Partition::from_labels(labels.collect(), partitions).unwrap()
}

/// Proper states by the definition: the largest set X that equals the least set Y with two kinds of states, the
/// absorbing ones and those with an action that stays in X and may enter Y. The sets grow and shrink one state at a
/// time.
fn plainly_proper(rows: &Rows) -> Vec<bool> {
    let all: BTreeSet<u32> = (0..rows.len() as u32).collect();
    let mut x = all.clone();
    loop {
        let mut y: BTreeSet<u32> = x.iter().copied().filter(|s| rows[*s as usize].is_empty()).collect();
        let may_enter = |s: &u32, y: &BTreeSet<u32>| {
            rows[*s as usize].iter().any(|(_, row)| {
                let mut next = row.iter().filter(|entry| entry.1 > 0.0);
                next.clone().all(|entry| x.contains(&entry.0)) && next.any(|entry| y.contains(&entry.0))
            })
        };
        while let Some(found) = x.iter().copied().find(|s| !y.contains(s) && may_enter(s, &y)) {
            y.insert(found);
        }
        if y == x {
            return all.iter().map(|s| x.contains(s)).collect();
        }
        x = y;
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn solvers_agree_with_discount(rows in random_rows(), g in 0.05f64..0.99, p in 1usize..9, seed in 0usize..99, k in 1u64..5) {
        let mdp = tabular(&rows, g).unwrap();
        check_agreement(&mdp, &partition(rows.len(), p, seed), 1e-3, k);
    }

    #[test]
    fn solvers_agree_without_discount(rows in random_rows(), p in 1usize..9, seed in 0usize..99, k in 1u64..5) {
        let mdp = tabular(&rows, 1.0).unwrap();
        check_agreement(&mdp, &partition(rows.len(), p, seed), 1e-3, k);
    }

    #[test]
    fn finite_values_are_those_of_proper_states(rows in random_rows()) {
        let mdp = tabular(&rows, 1.0).unwrap();
        let proper = proper_states(&mdp);
        prop_assert_eq!(&proper, &plainly_proper(&rows));
        // From below, value iteration grows without end where the execution cannot be made to end.
        let [early, late] = [3000, 6000].map(|sweeps| brute_force(&mdp, sweeps));
        for state in (0..rows.len()).filter(|state| !proper[*state]) {
            prop_assert!(late[state] > early[state], "state {}", state);
        }
    }

    #[test]
    fn dependencies_are_those_of_table_6_1(rows in random_rows(), p in 1usize..9, seed in 0usize..99) {
        let mdp = tabular(&rows, 0.9).unwrap();
        let partition = partition(rows.len(), p, seed);
        let (dependencies, states) = (Dependencies::new(&mdp, &partition), StateDependents::new(&mdp));
        let n = rows.len() as u32;
        let reaches = |from: u32, to: u32| rows[from as usize].iter().any(|(_, row)| row.iter().any(|e| e.0 == to && e.1 != 0.0));
        let label = |state: u32| partition.labels()[state as usize];
        for s in 0..n {
            let sds: Vec<u32> = (0..n).filter(|&from| reaches(from, s)).collect();
            let pds: BTreeSet<u32> = sds.iter().map(|&from| label(from)).collect();
            prop_assert_eq!(states.sds(s as usize), &sds);
            prop_assert_eq!(states.pds(s as usize, &partition), pds.into_iter().collect::<Vec<_>>());
        }
        for q in 0..p as u32 {
            let inside = |from: u32| (0..n).any(|to| label(to) == q && reaches(from, to));
            let sdp: BTreeSet<u32> = (0..n).filter(|&from| inside(from)).collect();
            let pdp: BTreeSet<u32> = sdp.iter().map(|&from| label(from)).collect();
            prop_assert_eq!(dependencies.sdp(q as usize).iter().copied().collect::<BTreeSet<_>>(), sdp.clone());
            prop_assert_eq!(dependencies.sdp(q as usize).len(), sdp.len());
            prop_assert_eq!(dependencies.pdp(q as usize), pdp.into_iter().collect::<Vec<_>>());
            for pair in dependencies.pairs(q as usize) {
                let dependent = dependencies.dependent(pair);
                let cut: Vec<u32> = sdp.iter().copied().filter(|&s| label(s) as usize == dependent).collect();
                prop_assert_eq!(dependencies.states(pair), cut);
                prop_assert!(dependencies.incoming(dependent).contains(&(pair as u32)));
            }
        }
    }

    #[test]
    fn the_queue_is_a_sorted_list(steps in prop::collection::vec((0usize..12, 0u8..6, 0u8..4), 0..200)) {
        let mut queue = IndexedMaxQueue::new(12);
        let mut model: Vec<Option<f64>> = vec![None; 12];
        let first = |model: &[Option<f64>]| {
            let queued = model.iter().enumerate().filter_map(|(index, key)| key.map(|key| (index, key)));
            queued.min_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)))
        };
        for (index, key, step) in steps {
            match step {
                0 => {
                    let popped = queue.pop();
                    prop_assert_eq!(popped, first(&model));
                    if let Some((index, _)) = popped {
                        model[index] = None;
                    }
                }
                1 => {
                    queue.remove(index);
                    model[index] = None;
                }
                _ => {
                    queue.set(index, f64::from(key));
                    model[index] = Some(f64::from(key));
                }
            }
            prop_assert_eq!(queue.peek(), first(&model));
            prop_assert_eq!(queue.len(), model.iter().flatten().count());
            (0..12).for_each(|index| assert_eq!(queue.key(index), model[index]));
        }
    }
}

#[test]
fn solvers_agree_where_blocks_and_patterns_matter() {
    // 10,000 states: several blocks, both fronts, repeating and unique patterns.
    let mut rows = grid_world(100, 100, |i, j| i % 30 == 20 && j % 40 > 10, 0.8);
    for (s, actions) in rows.iter_mut().enumerate().skip(7_500) {
        actions.iter_mut().for_each(|action| action.0 = 1.0 + (s % 997) as f64 * 1e-3);
    }
    for (discount, tolerance) in [(0.9, 0.1), (1.0, 50.0)] {
        let mdp = tabular(&rows, discount).unwrap();
        let partition = Partition::grid(rows.len(), [100, 100], [5, 5], |s| [s / 100, s % 100]).unwrap();
        check_agreement(&mdp, &partition, tolerance, u64::MAX);
    }
}

/// The message for a problem of four states after `spoil` has changed its rows.
fn message(discount: f64, spoil: impl FnOnce(&mut Rows)) -> String {
    let mut rows: Rows =
        (0..4).map(|s| vec![(1.0, vec![((s + 1) % 4, 0.5), (0, 0.5)]), (2.0, vec![(s, 1.0)])]).collect();
    spoil(&mut rows);
    tabular(&rows, discount).expect_err("a spoilt problem").to_string()
}

#[test]
fn the_first_offender_is_named() {
    let says =
        |text: String, place: &str, rule: &str| assert!(text.starts_with(place) && text.contains(rule), "{text}");
    says(
        message(0.9, |r| r[2][1].1[0].0 = 4),
        "state 2, action 1",
        "a successor must be less than the number of states (4)",
    );
    says(message(0.9, |r| r[1][0].1[1].1 = 0.25), "state 1, action 0", "the probabilities must sum to one (0.75)");
    says(message(0.9, |r| r[3][0].1[1].1 = f64::NAN), "state 3, action 0", "a probability must be in [0, 1] (NaN)");
    says(message(0.9, |r| r[3][0].1[1].1 = -0.5), "state 3, action 0", "a probability must be in [0, 1] (-0.5)");
    says(message(0.9, |r| r[0][1].0 = f64::INFINITY), "state 0, action 1", "the stage cost must be finite");
    says(message(0.9, |r| r[0][1].0 = f64::NAN), "state 0, action 1", "the stage cost must be finite");
    says(message(0.9, |r| r[0][1].1.clear()), "state 0, action 1", "the probabilities must sum to one (0)");
    says(message(1.0, |r| r[2][0].0 = -1.0), "state 2, action 0", "must not be negative if the discount is 1 (-1)");
    says(message(0.9, |r| (r[3][0].0, r[1][1].1[0].1) = (f64::NAN, 0.5)), "state 1, action 1", "sum to one");
    says(message(0.0, |_| ()), "discount = 0", "must be in (0, 1]");
    says(message(f64::NAN, |_| ()), "discount = NaN", "must be in (0, 1]");
    assert!(tabular(&vec![vec![(-1.0, vec![(0, 1.0)])]], 0.9).is_ok());
}

#[test]
fn arrays_that_do_not_fit_are_refused() {
    let new = |a: &[usize], r: &[usize], s: &[u32], p: &[f64], c: &[f64]| {
        TabularMdp::new(a, r, s, p, c, 0.9).map(|_| ()).map_err(|e| e.to_string())
    };
    let row = |state, action, what, value| Err(Error::Row { state, action, what, value }.to_string());
    assert_eq!(new(&[0, 1], &[0, 1], &[0], &[1.0], &[1.0]), Ok(()));
    assert_eq!(new(&[], &[0], &[], &[], &[]), Err("action_offsets: expected 1 elements, found 0".into()));
    assert_eq!(new(&[1], &[0], &[], &[], &[]), Err("action_offsets = 1: must begin with 0".into()));
    assert_eq!(new(&[0, 1], &[0], &[0], &[1.0], &[1.0]), Err("row_offsets: expected 2 elements, found 1".into()));
    assert_eq!(new(&[0, 1], &[0, 1], &[0], &[1.0], &[]), Err("stage_costs: expected 1 elements, found 0".into()));
    assert_eq!(new(&[0, 1], &[0, 1], &[0, 0], &[1.0], &[1.0]), Err("successors: expected 1 elements, found 2".into()));
    assert_eq!(new(&[0, 1], &[0, 1], &[0], &[], &[1.0]), Err("probabilities: expected 1 elements, found 0".into()));
    let what = "action_offsets must not fall, nor pass the number of rows";
    assert_eq!(new(&[0, 2, 1], &[0, 1], &[0], &[1.0], &[1.0]), row(0, 0, what, 2.0));
    let what = "row_offsets must not fall, nor pass the number of entries";
    assert_eq!(new(&[0, 1, 2], &[0, 5, 1], &[0], &[1.0], &[1.0, 1.0]), row(0, 0, what, 5.0));
    assert_eq!(new(&[0, usize::MAX], &[0], &[], &[], &[]).map_err(|e| e.len() > 20), Err(true));
}

#[test]
fn labels_rules_and_options_are_checked() {
    let rule = StopRule::new(1e-3).unwrap();
    assert_eq!(
        Partition::from_labels(vec![0, 1, 3, 9], 3).map_err(|e| e.to_string()),
        Err("labels = 3 at state 2: must be less than the number of partitions".into())
    );
    assert!(Partition::grid(12, [4, 3], [5, 1], |s| [s / 3, s % 3]).is_err());
    assert!(Partition::grid(12, [4, 3], [2, 0], |s| [s / 3, s % 3]).is_err());
    assert!(Partition::grid(13, [4, 3], [2, 2], |s| [s / 3, s % 3]).is_err());
    let mdp = chain(5, 0.9);
    let (wrong, options) = (Partition::whole(4).unwrap(), PrioritizedOptions::default());
    assert!(matches!(prioritized(&mdp, &wrong, options, rule, None), Err(Error::Length { expected: 5, found: 4, .. })));
    let whole = Partition::whole(5).unwrap();
    let options = PrioritizedOptions { inner_tolerance: Some(f64::NAN), ..options };
    assert!(prioritized(&mdp, &whole, options, rule, None).is_err());
    let options = PrioritizedOptions { inner_tolerance: None, inner_sweeps: 0, ..options };
    assert!(prioritized(&mdp, &whole, options, rule, None).is_err());
    let rule = StopRule { tolerance: -1.0, ..rule };
    assert!(value_iteration(&mdp, rule, None).is_err() && tabular_sweep(&mdp, rule, None).is_err());
    for priority in METRICS {
        assert_eq!(priority.name().parse::<Priority>(), Ok(priority));
    }
    assert!("h3".parse::<Priority>().is_err());
}

#[test]
fn every_solver_keeps_to_limits_and_says_so() {
    // 3000 steps, against the index order in half of the problem: no solver is done after a sweep or two.
    let rows: Rows = (0..3000u32)
        .map(|s| if s == 0 { vec![] } else { vec![(1.0, vec![(s * 7 % 3000, 0.9), (s - 1, 0.1)])] })
        .collect();
    let mdp = tabular(&rows, 0.999).unwrap();
    let partition = Partition::from_labels((0..3000).map(|s| s / 100).collect(), 30).unwrap();
    let options = PrioritizedOptions::default();
    let rule = StopRule::new(1e-6).unwrap();
    let short = StopRule { max_sweeps: 2, ..rule };
    let late = StopRule { time_limit: Some(Duration::ZERO), ..rule };
    for (rule, stop, status) in
        [(short, false, Status::IterationLimit), (late, false, Status::TimeLimit), (rule, true, Status::Interrupted)]
    {
        let mut calls = 0;
        let mut observe = |progress: &Progress| {
            calls += 1;
            assert!(progress.residual >= 0.0 && progress.threshold > 0.0 && progress.sweeps > 0.0);
            if stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        for solution in [
            value_iteration(&mdp, rule, Some(&mut observe)).unwrap(),
            tabular_sweep(&mdp, rule, Some(&mut observe)).unwrap(),
            prioritized(&mdp, &partition, options, rule, Some(&mut observe)).unwrap(),
        ] {
            assert_eq!(solution.report.status, status);
            assert_eq!(solution.report.residual, residual(&mdp, &solution.values));
            assert!(solution.report.residual > 1e-9 && solution.report.error_bound > 1e-6);
        }
        assert!(calls >= 3);
    }
}

#[test]
fn any_problem_becomes_a_table() {
    let mdp = tabular(&grid_world(6, 5, |_, _| false, 0.7), 0.9).unwrap();
    assert_eq!(TabularMdp::from_mdp(&mdp).unwrap(), mdp);

    /// Ends with probability 1/2 in every step.
    struct Leaky;
    impl Mdp for Leaky {
        fn states(&self) -> usize {
            1
        }
        fn discount(&self) -> f64 {
            1.0
        }
        fn actions(&self, _: usize) -> usize {
            1
        }
        fn stage_cost(&self, _: usize, _: usize) -> f64 {
            3.0
        }
        fn for_each_successor(&self, _: usize, _: usize, mut visit: impl FnMut(usize, f64)) {
            visit(0, 0.5);
        }
    }
    let rule = StopRule::new(1e-6).unwrap();
    let table = TabularMdp::from_mdp(&Leaky).unwrap();
    assert_eq!(table.states(), 2);
    let solutions = [value_iteration(&Leaky, rule, None).unwrap(), tabular_sweep(&table, rule, None).unwrap()];
    solutions.iter().for_each(|solution| assert!((solution.values[0] - 6.0).abs() < 1e-6));
}
