//! The same bits on one, two and three threads, and on every run.

mod cases;

use cases::random::{self, Random};
use cases::{grid_world, tabular};
use ppvi::lattice::sweep;
use ppvi::{
    Evaluation, Partition, PrioritizedOptions, Priority, Report, Solution, StopRule, TabularMdp, policy_iteration,
    prioritized, tabular_sweep, value_iteration,
};

/// A problem of 13,000 states, which the solvers cut into several blocks.
fn problem(discount: f64) -> TabularMdp<'static> {
    let mut rows = grid_world(130, 100, |i, j| i % 40 == 20 && j > 20, 0.7);
    for (s, actions) in rows.iter_mut().enumerate() {
        actions.iter_mut().for_each(|action| action.0 += (s * s % 17) as f64 * 0.05);
    }
    tabular(&rows, discount).unwrap()
}

fn on_threads<R: Send>(threads: usize, solve: impl Fn() -> R + Send + Sync) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(solve)
}

/// The whole solution except for the times.
fn fingerprint(solution: Solution) -> (Vec<u64>, Vec<u32>, Report) {
    let bits = solution.values.iter().map(|value| value.to_bits()).collect();
    (bits, solution.policy, Report { seconds_solving: 0.0, seconds_priorities: 0.0, ..solution.report })
}

fn assert_same(solve: impl Fn() -> Solution + Send + Sync) {
    let first = fingerprint(on_threads(1, &solve));
    for threads in [2, 3, 3] {
        assert!(fingerprint(on_threads(threads, &solve)) == first, "{threads} threads");
    }
}

#[test]
fn value_iteration_is_deterministic() {
    let mdp = problem(0.9);
    assert_same(|| value_iteration(&mdp, StopRule::new(0.1).unwrap(), None).unwrap());
}

#[test]
fn tabular_sweep_is_deterministic() {
    for (discount, tolerance) in [(0.9, 0.1), (1.0, 60.0)] {
        let mdp = problem(discount);
        let rule = StopRule::new(tolerance).unwrap();
        assert_same(|| tabular_sweep(&mdp, rule, None).unwrap());
        // Half-way, too.
        let rule = StopRule { max_sweeps: 3, ..rule };
        assert_same(|| tabular_sweep(&mdp, rule, None).unwrap());
    }
}

#[test]
fn policy_iteration_is_deterministic() {
    for (discount, evaluation) in [(0.99, Evaluation::Auto), (0.9, Evaluation::Sweeps), (1.0, Evaluation::Auto)] {
        let mdp = problem(discount);
        assert_same(|| policy_iteration(&mdp, evaluation, None, StopRule::new(0.1).unwrap(), None).unwrap());
    }
}

#[test]
fn the_prioritized_solver_is_deterministic() {
    let mdp = problem(0.9);
    let partition = Partition::grid(13_000, [130, 100], [6, 4], |s| [s / 100, s % 100]).unwrap();
    for priority in [Priority::H1, Priority::H2, Priority::Bound] {
        let options = PrioritizedOptions { priority, ..PrioritizedOptions::default() };
        assert_same(|| prioritized(&mdp, &partition, options, StopRule::new(1.0).unwrap(), None).unwrap());
    }
}

#[test]
fn prioritized_sweeps_of_a_lattice_are_deterministic() {
    for seed in 0..40 {
        let lattice = random::lattice(&mut Random(seed)).unwrap();
        for max_sweeps in [3, 50] {
            let rule = StopRule { max_sweeps, ..StopRule::new(1e-3).unwrap() };
            let solve = || {
                let solved = sweep::prioritized(&lattice, [1, 1], rule, None).unwrap();
                let bits: Vec<u32> = solved.values.iter().map(|value| value.to_bits()).collect();
                (bits, solved.policy, Report { seconds_solving: 0.0, ..solved.report })
            };
            let first = on_threads(1, solve);
            for threads in [2, 3, 7] {
                assert!(on_threads(threads, solve) == first, "seed {seed}, {threads} threads");
            }
        }
    }
}
