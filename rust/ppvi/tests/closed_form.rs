//! Problems with a solution in closed form.

mod cases;

use cases::{Rows, chain, grid_world, tabular};
use ppvi::{
    Mdp, Partition, PrioritizedOptions, Priority, Solution, Status, StopRule, TabularMdp, prioritized, tabular_sweep,
    value_iteration,
};

/// Solutions of every solver; the prioritized one with every metric on partitions of `size` states.
fn solve_all(mdp: &TabularMdp, tolerance: f64, size: usize) -> Vec<Solution> {
    let rule = StopRule::new(tolerance).unwrap();
    let labels = (0..mdp.states()).map(|s| (s / size) as u32).collect();
    let partition = Partition::from_labels(labels, mdp.states().div_ceil(size)).unwrap();
    let mut solutions = vec![value_iteration(mdp, rule, None).unwrap(), tabular_sweep(mdp, rule, None).unwrap()];
    for priority in [Priority::H1, Priority::H2, Priority::Bound] {
        let options = PrioritizedOptions { priority, ..PrioritizedOptions::default() };
        solutions.push(prioritized(mdp, &partition, options, rule, None).unwrap());
    }
    solutions
}

fn assert_values(mdp: &TabularMdp, tolerance: f64, expected: &[f64]) {
    for solution in solve_all(mdp, tolerance, 3) {
        assert_eq!(solution.report.status, Status::Converged);
        assert!(solution.report.error_bound <= tolerance, "{:?}", solution.report);
        for (state, (&value, &want)) in solution.values.iter().zip(expected).enumerate() {
            assert!(ppvi::bellman::change(value, want) <= tolerance, "state {state}: {value}, expected {want}");
        }
    }
}

#[test]
fn two_states_that_swap() {
    // a = 1 + g b, b = 3 + g a
    let mdp = tabular(&vec![vec![(1.0, vec![(1, 1.0)])], vec![(3.0, vec![(0, 1.0)])]], 0.9).unwrap();
    let determinant = 1.0 - 0.81;
    assert_values(&mdp, 1e-6, &[(1.0 + 0.9 * 3.0) / determinant, (3.0 + 0.9) / determinant]);
}

#[test]
fn a_self_loop_is_a_geometric_series() {
    let mdp = tabular(&vec![vec![(2.0, vec![(0, 1.0)])]], 0.5).unwrap();
    assert_values(&mdp, 1e-9, &[4.0]);
    let mdp = tabular(&vec![vec![(2.0, vec![(0, 0.75), (1, 0.25)])], vec![]], 1.0).unwrap();
    assert_values(&mdp, 1e-6, &[8.0, 0.0]);
}

#[test]
fn the_cheaper_action_is_taken() {
    let rows: Rows = vec![vec![(5.0, vec![(2, 1.0)]), (1.0, vec![(1, 1.0)])], vec![(1.0, vec![(2, 1.0)])], vec![]];
    let mdp = tabular(&rows, 1.0).unwrap();
    assert_values(&mdp, 1e-6, &[2.0, 1.0, 0.0]);
    for solution in solve_all(&mdp, 1e-6, 1) {
        assert_eq!(solution.policy, [1, 0, 0]);
    }
}

#[test]
fn a_discounted_chain() {
    let discount: f64 = 0.9;
    let expected: Vec<f64> = (0..50).map(|s| (1.0 - discount.powi(49 - s)) / (1.0 - discount)).collect();
    assert_values(&chain(50, discount), 1e-6, &expected);
}

#[test]
fn negative_costs_are_fine_with_a_discount() {
    let rows: Rows = vec![vec![(-1.0, vec![(0, 1.0)]), (-3.0, vec![(1, 1.0)])], vec![]];
    assert_values(&tabular(&rows, 0.5).unwrap(), 1e-9, &[-3.0, 0.0]);
}

#[test]
fn the_shortest_path_on_a_grid() {
    let rows = grid_world(9, 7, |_, _| false, 1.0);
    let expected: Vec<f64> = (0..63).map(|s| (s / 7 + s % 7) as f64).collect();
    assert_values(&tabular(&rows, 1.0).unwrap(), 1e-6, &expected);
    // A move that succeeds with probability 1/4 takes four times as long.
    let rows = grid_world(9, 7, |_, _| false, 0.25);
    let expected: Vec<f64> = expected.iter().map(|v| 4.0 * v).collect();
    assert_values(&tabular(&rows, 1.0).unwrap(), 1e-6, &expected);
}

#[test]
fn the_gambler_plays_until_ruin_or_riches() {
    // A fair game between 0 and 20 lasts s (20 - s) rounds on average.
    let state = |s: u32| if s == 0 || s == 20 { vec![] } else { vec![(1.0, vec![(s - 1, 0.5), (s + 1, 0.5)])] };
    let mdp = tabular(&(0..21).map(state).collect(), 1.0).unwrap();
    let expected: Vec<f64> = (0..21).map(|s| f64::from(s * (20 - s))).collect();
    assert_values(&mdp, 1e-4, &expected);
}

#[test]
fn what_cannot_end_costs_infinity() {
    let rows: Rows = vec![
        vec![],
        vec![(1.0, vec![(0, 1.0)])],
        vec![(1.0, vec![(2, 1.0)])],                                  // loops for ever
        vec![(1.0, vec![(0, 0.5), (2, 0.5)])],                        // may fall into the loop
        vec![(1.0, vec![(3, 1.0)]), (7.0, vec![(1, 1.0)])],           // avoids it at a price
        vec![(1.0, vec![(5, 0.9), (4, 0.1), (2, 0.0)])],              // probability zero does not count
        vec![(1.0, vec![(3, 1.0)]), (1.0, vec![(6, 0.5), (2, 0.5)])], // has no way out
    ];
    let infinity = f64::INFINITY;
    let mdp = tabular(&rows, 1.0).unwrap();
    assert_values(&mdp, 1e-6, &[0.0, 1.0, infinity, infinity, 8.0, 18.0, infinity]);
    assert_eq!(ppvi::proper_states(&mdp), [true, true, false, false, true, true, false]);
}

#[test]
fn the_order_of_the_indices_does_not_matter() {
    // A chain whose k-th link has index 1103 k mod 2003; from every tenth link a detour leads to a trap.
    let (links, trap) = (2003, 2003);
    let place = |k: u32| k * 1103 % links;
    let mut rows: Rows = vec![vec![]; links as usize + 1];
    for k in 1..links {
        rows[place(k) as usize].push((1.0, vec![(place(k - 1), 1.0)]));
        if k % 10 == 0 {
            rows[place(k) as usize].push((0.5, vec![(place(k - 1), 0.5), (trap, 0.5)]));
        }
    }
    rows[trap as usize].push((1.0, vec![(trap, 1.0)]));
    let mut expected = vec![f64::INFINITY; links as usize + 1];
    (0..links).for_each(|k| expected[place(k) as usize] = f64::from(k));
    let mdp = tabular(&rows, 1.0).unwrap();
    let proper: Vec<bool> = expected.iter().map(|value| value.is_finite()).collect();
    assert_eq!(ppvi::proper_states(&mdp), proper);
    assert_values(&mdp, 1.0, &expected);
}

#[test]
fn an_unreachable_target_ends_the_solve() {
    let rows = grid_world(8, 8, |i, _| i == 3, 1.0);
    let mdp = tabular(&rows, 1.0).unwrap();
    for solution in solve_all(&mdp, 1e-3, 16) {
        assert_eq!(solution.report.status, Status::Converged);
        assert!((0..24).all(|s| solution.values[s].is_finite()));
        assert!((32..64).all(|s| solution.values[s] == f64::INFINITY));
    }
    let nowhere = tabular(&vec![vec![(1.0, vec![(1, 1.0)])], vec![(1.0, vec![(0, 1.0)])]], 1.0).unwrap();
    for solution in solve_all(&nowhere, 1e-3, 1) {
        assert_eq!(solution.values, [f64::INFINITY; 2]);
    }
}

#[test]
fn a_single_step_is_never_taken_for_free() {
    // With all values zero the residual is the least stage cost, and the threshold may be that but for rounding.
    for cost in (0..2000).map(|k| f64::from(k) * 0.000_731 + 0.499_540_352_207_309_5) {
        assert_values(&tabular(&vec![vec![], vec![(cost, vec![(0, 1.0)])]], 1.0).unwrap(), 1e-3, &[0.0, cost]);
    }
}

#[test]
fn free_steps_are_proved_too_unless_they_form_a_loop() {
    let rows = |back: f64| -> Rows {
        let first = vec![(0.0, vec![(1, 1.0)]), (0.0, vec![(3, 1.0), (0, 0.0)])];
        vec![first, vec![(0.0, vec![(2, 1.0)])], vec![(1.0, vec![(3, 1.0)]), (back, vec![(0, 1.0)])], vec![]]
    };
    assert_values(&tabular(&rows(0.5), 1.0).unwrap(), 1e-6, &[0.0, 0.5, 0.5, 0.0]);
    let message = tabular(&rows(0.0), 1.0).expect_err("a loop").to_string();
    assert!(message.starts_with("state 2, action 1: steps of cost zero must not form a loop"), "{message}");
    assert!(tabular(&rows(0.0), 0.9).is_ok());
    let itself = tabular(&vec![vec![(0.0, vec![(0, 1.0)])]], 1.0).expect_err("a loop").to_string();
    assert!(itself.starts_with("state 0, action 0: steps of cost zero must not form a loop"), "{itself}");
    // No cost at all.
    assert_values(&tabular(&vec![vec![(0.0, vec![(1, 1.0)])], vec![]], 1.0).unwrap(), 1e-6, &[0.0, 0.0]);
}

#[test]
fn a_tolerance_below_the_rounding_is_a_precision_limit() {
    for discount in [0.9, 1.0] {
        let rows = grid_world(9, 7, |_, _| false, 0.7);
        for solution in solve_all(&tabular(&rows, discount).unwrap(), 1e-17, 5) {
            assert_eq!(solution.report.status, Status::PrecisionLimit);
            assert!(solution.report.error_bound > 1e-17 && solution.report.error_bound < 1e-9);
            assert!(solution.report.backups < 63 * 2000);
        }
    }
}

#[test]
fn no_states_and_nothing_but_absorbing_states() {
    for rows in [vec![], vec![vec![], vec![]]] {
        for discount in [0.5, 1.0] {
            for solution in solve_all(&tabular(&rows, discount).unwrap(), 1e-6, 1) {
                assert_eq!(solution.values, vec![0.0; rows.len()]);
                assert_eq!(solution.report.status, Status::Converged);
                assert_eq!(solution.report.residual, 0.0);
            }
        }
    }
}

#[test]
fn partitions_of_obstacles_are_never_processed() {
    let mut rows = grid_world(12, 4, |_, _| false, 1.0);
    rows[16..32].iter_mut().for_each(Vec::clear); // columns 4 to 7 absorb
    let mdp = tabular(&rows, 0.9).unwrap();
    let partition = Partition::grid(48, [12, 4], [3, 1], |s| [s / 4, s % 4]).unwrap();
    for priority in [Priority::H1, Priority::H2, Priority::Bound] {
        let options = PrioritizedOptions { priority, ..PrioritizedOptions::default() };
        let report = prioritized(&mdp, &partition, options, StopRule::new(1e-3).unwrap(), None).unwrap().report;
        assert_eq!((report.partitions, report.order.len()), (3, 2));
        assert!(!report.order.contains(&1));
    }
}
