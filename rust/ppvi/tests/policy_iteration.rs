//! Policy iteration by components: the order of indices, long chains, starts, and problems under a policy.

mod cases;

use cases::{Rows, grid_world, tabular};
use ppvi::{Error, Evaluation, Mdp, Solution, Status, StopRule, TabularMdp, policy_iteration, value_iteration};

fn check_solution(mdp: &TabularMdp, tolerance: f64, solution: &Solution) {
    assert_eq!(solution.report.status, Status::Converged);
    assert!(solution.report.error_bound <= tolerance, "{:?}", solution.report);
    for state in 0..mdp.states() {
        let (value, action) = mdp.backup(state, &solution.values);
        assert!((value - solution.values[state]).abs() <= solution.report.residual);
        assert_eq!(solution.policy[state] as usize, action, "greedy at {state}");
    }
}

/// Rows in a random order of their states.
fn shuffled(rows: &Rows, seed: usize) -> Rows {
    let n = rows.len();
    let mut keys: Vec<usize> = (0..n).collect();
    keys.sort_by_key(|s| (s + seed).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 13);
    let mut place = vec![0; n];
    keys.iter().enumerate().for_each(|(new, &old)| place[old] = new as u32);
    let moved = |row: &Vec<(u32, f64)>| row.iter().map(|&(next, p)| (place[next as usize], p)).collect();
    keys.iter().map(|&old| rows[old].iter().map(|(cost, row)| (*cost, moved(row))).collect()).collect()
}

#[test]
fn an_acyclic_problem_takes_one_backup_per_state_in_any_order() {
    let step = |s: usize| match s + 1 < 3000 {
        true => {
            vec![(1.0, vec![(s as u32 + 1, 0.5), ((s as u32 + 7).min(2999), 0.5)]), (3.0, vec![(s as u32 + 1, 1.0)])]
        }
        false => vec![],
    };
    let rows = shuffled(&(0..3000).map(step).collect(), 5);
    for discount in [0.9, 1.0] {
        let mdp = tabular(&rows, discount).unwrap();
        let solution = policy_iteration(&mdp, Evaluation::Auto, None, StopRule::new(1e-6).unwrap(), None).unwrap();
        check_solution(&mdp, 1e-6, &solution);
        // One for each state that is not absorbing, and one for each state in the check.
        assert_eq!(solution.report.backups, 2 * 3000 - 1);
        assert_eq!(solution.report.partitions, 2999);
    }
}

#[test]
fn long_chains_in_any_order_take_few_rounds() {
    // A walk on a line of 2,000 places with two speeds, reflected at its ends.
    let walk = |s: usize| {
        let step = |up: f64, cost: f64| (cost, vec![((s as u32 + 1).min(1999), up), (s.max(1) as u32 - 1, 1.0 - up)]);
        vec![step(0.3, s as f64 / 1000.0), step(0.6, 1.0 + (s * s % 17) as f64 / 20.0)]
    };
    for rows in [(0..2000).map(walk).collect(), shuffled(&(0..2000).map(walk).collect(), 3)] {
        let mdp = tabular(&rows, 0.9999).unwrap();
        for evaluation in [Evaluation::Auto, Evaluation::Solve] {
            let solution = policy_iteration(&mdp, evaluation, None, StopRule::new(1e-4).unwrap(), None).unwrap();
            check_solution(&mdp, 1e-4, &solution);
            assert!(solution.report.backups < 2_000_000, "{}", solution.report.backups);
        }
    }
}

#[test]
fn a_start_near_the_values_saves_backups_and_a_wrong_one_is_refused() {
    let mdp = tabular(&grid_world(20, 20, |i, j| i == 10 && j > 3, 0.6), 0.99).unwrap();
    let rule = StopRule::new(1e-6).unwrap();
    let solve = |start: Option<&[f64]>| policy_iteration(&mdp, Evaluation::Auto, start, rule, None);
    let cold = solve(None).unwrap();
    let warm = solve(Some(&cold.values)).unwrap();
    check_solution(&mdp, 1e-6, &warm);
    assert!(warm.report.backups < cold.report.backups / 3);
    assert!(matches!(solve(Some(&[0.0])), Err(Error::Length { name: "start", .. })));
    assert!(matches!(solve(Some(&[f64::NAN; 400])), Err(Error::Parameter { name: "start", .. })));
}

#[test]
fn a_problem_under_a_policy_has_the_values_of_the_policy() {
    let rows = vec![vec![(1.0, vec![(1, 1.0)]), (5.0, vec![(2, 1.0)])], vec![(1.0, vec![(2, 1.0)])], vec![]];
    let mdp = tabular(&rows, 1.0).unwrap();
    let solve = |policy: &[u32]| {
        policy_iteration(&mdp.under_policy(policy)?, Evaluation::Auto, None, StopRule::new(1e-9)?, None)
    };
    assert_eq!(solve(&[1, 0, 0]).unwrap().values, [5.0, 1.0, 0.0]);
    assert_eq!(solve(&[0, 0, 0]).unwrap().values, [2.0, 1.0, 0.0]);
    assert!(matches!(solve(&[0, 1, 0]), Err(Error::Row { state: 1, action: 1, .. })));
    assert!(matches!(solve(&[0]), Err(Error::Length { name: "policy", .. })));
}

#[test]
fn limits_end_the_solve_with_a_status() {
    let mdp = tabular(&grid_world(300, 100, |_, _| false, 0.6), 0.9999).unwrap();
    for evaluation in [Evaluation::Auto, Evaluation::Sweeps] {
        let rule = StopRule { max_sweeps: 5, ..StopRule::new(1e-6).unwrap() };
        let solution = policy_iteration(&mdp, evaluation, None, rule, None).unwrap();
        assert_eq!(solution.report.status, Status::IterationLimit);
        assert!(solution.report.backups < 60 * 30_000);
        let reference = value_iteration(&mdp, StopRule { max_sweeps: 50, ..rule }, None).unwrap();
        let bound = solution.report.error_bound + reference.report.error_bound;
        assert!(solution.values.iter().zip(&reference.values).all(|(a, b)| (a - b).abs() <= bound));
    }
}

#[test]
fn a_first_policy_that_never_ends_is_left() {
    let rows = vec![
        vec![(8.0, vec![(2, 0.5), (1, 0.5)])],
        vec![(3.5, vec![(3, 1.0)])],
        vec![(1.9, vec![(3, 1.0)]), (2.7, vec![(4, 1.0)])],
        vec![(2.4, vec![(0, 0.75), (1, 0.25)])],
        vec![],
    ];
    let mdp = tabular(&rows, 1.0).unwrap();
    for evaluation in [Evaluation::Auto, Evaluation::Sweeps, Evaluation::Solve] {
        check_solution(
            &mdp,
            1e-6,
            &policy_iteration(&mdp, evaluation, None, StopRule::new(1e-6).unwrap(), None).unwrap(),
        );
    }
}

#[test]
fn states_that_hardly_ever_change_do_not_spoil_the_precision_of_others() {
    // State 0 mostly stays, and the value of state 1 follows it.
    let rows: Rows = vec![
        vec![(0.7, vec![(0, 0.9997), (1, 0.0003)]), (0.9, vec![(1, 0.5), (0, 0.5)])],
        vec![(0.3, vec![(0, 0.4), (2, 0.6)]), (0.5, vec![(0, 1.0)])],
        vec![(1.0, vec![(1, 0.9), (2, 0.1)])],
    ];
    let mdp = tabular(&rows, 0.9999).unwrap();
    for evaluation in [Evaluation::Auto, Evaluation::Solve] {
        let solution = policy_iteration(&mdp, evaluation, None, StopRule::new(1e-6).unwrap(), None).unwrap();
        check_solution(&mdp, 1e-6, &solution);
    }
}
