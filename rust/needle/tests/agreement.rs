//! The lattice solver against the general solvers, on the same problems.

use needle::{Area, Bicycle, Clearance, Setup, SteeringProblem, Straight, Tissues, Workspace};
use ppvi::lattice::evaluation::{self, Evaluation};
use ppvi::lattice::sweep::{self, LatticeSolution};
use ppvi::lattice::{Costs, LatticeMdp, Transition};
use ppvi::{
    Mdp, Order, PrioritizedOptions, Priority, Status, StopRule, TabularMdp, prioritized, tabular_sweep, value_iteration,
};
use proptest::prelude::*;

/// Small workspaces with two obstacles, any needle, any noise, both transitions, discounted or not; steps of one heading
/// or of any length, with noise steps of their own and a straight layer.
fn setups() -> impl Strategy<Value = Setup> {
    let geometry = (6.0..14.0f64, 5.0..10.0f64, 0.6..1.5f64, 0.6..1.5f64, 4.0..30.0f64, 4usize..24);
    let noise = prop_oneof![
        Just(vec![1.0]),
        Just(vec![0.5, 0.25]),
        Just(vec![0.466, 0.24, 0.027]),
        Just(vec![0.3, 0.2, 0.1, 0.05])
    ];
    let costs =
        prop_oneof![Just((40.0, 200.0, 100.0, 0.95)), Just((4.0, 1000.0, 700.0, 1.0)), Just((0.0, 50.0, 80.0, 0.8))];
    // Length of a step and noise step, as multiples of those of the thesis.
    let general = prop::option::of((0.3..2.5f64, 0.2..1.7f64));
    // Distance and price of clearance.
    let clearance = prop::option::of((0.0..2.0f64, 0.1..5.0f64));
    let straight = prop::option::of((prop_oneof![Just(0.0), 0.0..1.0f64], 0.3..3.0f64));
    let prices = (clearance, straight);
    (geometry, noise, costs, 1usize..5, any::<bool>(), 0.0..1.0f64, 0usize..4, general, prices).prop_map(
        |(geometry, noise, costs, arc_samples, interpolated, at, tissues, general, (clearance, straight))| {
            let (width, height, dx, dy, radius, headings) = geometry;
            let (rotation, collision, exit, discount) = costs;
            let triangle =
                |x: f64, y: f64| Area::polygon(vec![[x, y], [x + 2.0, y + 0.3], [x + 0.7, y + 1.9]]).unwrap();
            let obstacles =
                vec![triangle(0.3 * width, 0.1 + at * 0.5 * height), triangle(0.55 * width, (1.0 - at) * 0.6 * height)];
            let mut needle = Bicycle::new(radius, headings).unwrap();
            if let Some((times, _)) = general {
                needle = needle.with_step((times * needle.step_length()).min(radius)).unwrap();
            }
            // None, a layer, or a layer and a region over it.
            let layers = vec![(0.4 * width, 0.7 * radius)];
            let region = (triangle(0.2 * width, 0.3 * height), 1.4 * radius);
            let tissues = match tissues {
                0 => Tissues::default(),
                1 => Tissues::new(layers, vec![]).unwrap(),
                2 if general.is_some() => Tissues::new(vec![(0.5 * width, f64::INFINITY)], vec![]).unwrap(),
                _ => Tissues::new(layers, vec![region]).unwrap(),
            };
            let (distance, price) = clearance.unwrap_or_default();
            Setup {
                clearance: Clearance::new(&obstacles, distance, price).unwrap(),
                workspace: Workspace::new([width, height], obstacles, [0.85 * width, 0.5 * height], 1.1).unwrap(),
                needle,
                spacing: [dx, dy],
                noise,
                noise_step: general.map(|(_, times)| times * needle.heading_step()),
                arc_samples,
                transition: if interpolated { Transition::Interpolated } else { Transition::Nearest },
                costs: Costs { step: needle.step_length(), rotation, collision, exit, discount },
                tissues,
                straight: straight.map(|(curvature_share, cost_per_mm)| Straight { curvature_share, cost_per_mm }),
            }
        },
    )
}

fn rule(tolerance: f64) -> StopRule {
    let mut rule = StopRule::new(tolerance).unwrap();
    // A step that rounds to no movement never ends; that is a status, not a failure of this test.
    rule.max_sweeps = 3000;
    rule
}

fn on_threads<R: Send>(threads: usize, work: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

/// Success probability of a policy, by many sweeps over the transition probabilities of the definition.
fn evaluate_plainly(lattice: &LatticeMdp, policy: &[u8]) -> Vec<f64> {
    let by_motion: Vec<Vec<u8>> = lattice.parts().motions().iter().map(|m| lattice.outcome_table(*m)).collect();
    let codes = &by_motion[0];
    let at_target = |code: &u8| f64::from(u8::from(*code == ppvi::lattice::outcome::AT_TARGET));
    let mut success: Vec<f64> = codes.iter().map(at_target).collect();
    for _ in 0..4000 {
        let next: Vec<f64> = (0..lattice.states())
            .map(|state| {
                if lattice.actions(state) == 0 {
                    return success[state];
                }
                let action = usize::from(policy[state]);
                let code = match action {
                    2 => by_motion[1][state],
                    _ => codes[state ^ action],
                };
                let mut sum = f64::from(u8::from(code == ppvi::lattice::outcome::TARGET));
                lattice.for_each_successor(state, action, |next, p| sum += p * success[next]);
                sum
            })
            .collect();
        let change = next.iter().zip(&success).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        success = next;
        if change < 1e-12 {
            break;
        }
    }
    success
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn all_solvers_give_the_same_values(setup in setups(), px in 1usize..4, py in 1usize..4) {
        let problem = SteeringProblem::new(setup).unwrap();
        let lattice = problem.lattice();
        let swept = sweep::solve(lattice, rule(1e-3), None).unwrap();
        let reference = value_iteration(lattice, rule(1e-6), None).unwrap();
        prop_assume!(swept.report.status == Status::Converged && reference.report.status == Status::Converged);
        let largest = reference.values.iter().copied().fold(0.0, f64::max);
        let bound = swept.report.error_bound + reference.report.error_bound + 1e-9 * largest;
        for (state, (a, b)) in swept.values.iter().zip(&reference.values).enumerate() {
            prop_assert!((f64::from(*a) - b).abs() <= bound, "state {}: {} against {}, bound {}", state, a, b, bound);
        }
        // The reported residual is a bound on the exact one, but for the rounding of the values to single precision.
        let values: Vec<f64> = swept.values.iter().copied().map(f64::from).collect();
        let residual = (0..values.len()).map(|s| (lattice.backup(s, &values).0 - values[s]).abs()).fold(0.0, f64::max);
        let rounded = largest * f64::from(f32::EPSILON);
        prop_assert!(residual <= swept.report.residual + rounded, "{} > {}", residual, swept.report.residual);
        let partition = lattice.partition([px, py]).unwrap();
        for priority in [Priority::H1, Priority::H2, Priority::Bound] {
            let options = PrioritizedOptions { priority, ..PrioritizedOptions::default() };
            let blocks = prioritized(lattice, &partition, options, rule(1e-3), None).unwrap();
            prop_assert_eq!(blocks.report.status, Status::Converged);
            let bound = blocks.report.error_bound + reference.report.error_bound + 1e-9 * largest;
            for (a, b) in blocks.values.iter().zip(&reference.values) {
                prop_assert!((a - b).abs() <= bound);
            }
        }
        // Where an action is better than the others by more than both errors, it is the one in the table.
        for state in (0..lattice.states()).filter(|s| lattice.actions(*s) > 0) {
            let mut q: Vec<(f64, usize)> =
                (0..lattice.actions(state)).map(|a| (lattice.q_value(state, a, &reference.values), a)).collect();
            q.sort_by(|a, b| a.0.total_cmp(&b.0));
            if q[1].0 - q[0].0 > 2.0 * bound {
                prop_assert_eq!(usize::from(swept.policy[state]), q[0].1);
            }
        }
    }

    #[test]
    fn the_explicit_rows_are_the_same_problem(setup in setups()) {
        let problem = SteeringProblem::new(setup).unwrap();
        let lattice = problem.lattice();
        let explicit = TabularMdp::from_mdp(lattice).unwrap();
        let swept = sweep::solve(lattice, rule(1e-3), None).unwrap();
        let tabular = tabular_sweep(&explicit, rule(1e-3), None).unwrap();
        prop_assume!(swept.report.status == Status::Converged && tabular.report.status == Status::Converged);
        let bound = swept.report.error_bound + tabular.report.error_bound + 1e-9;
        for (a, b) in swept.values.iter().zip(&tabular.values) {
            prop_assert!((f64::from(*a) - b).abs() <= bound, "{} against {}", a, b);
        }
    }

    #[test]
    fn a_backup_is_the_better_q_value(setup in setups(), values in prop::collection::vec(0.0..100.0f64, 97)) {
        let problem = SteeringProblem::new(setup).unwrap();
        let lattice = problem.lattice();
        let values: Vec<f64> = values.into_iter().cycle().take(lattice.states()).collect();
        for state in 0..lattice.states() {
            let (value, action) = lattice.backup(state, &values);
            if lattice.actions(state) == 0 {
                prop_assert_eq!(value, lattice.absorbing_value(state));
                continue;
            }
            let q: Vec<f64> = (0..lattice.actions(state)).map(|a| lattice.q_value(state, a, &values)).collect();
            prop_assert!((value - q[action]).abs() < 1e-9 && q.iter().all(|other| value <= other + 1e-9));
        }
    }

    #[test]
    fn steps_that_round_to_nothing_have_infinite_values(setup in setups(), divide in 2.0..12.0f64) {
        let mut setup = setup;
        setup.transition = Transition::Nearest;
        setup.costs = Costs { discount: 1.0, rotation: 4.0, ..setup.costs };
        setup.needle = match setup.needle.step {
            Some(length) => setup.needle.with_step(length / divide).unwrap(),
            None => Bicycle::new(setup.needle.radius / divide, setup.needle.headings).unwrap(),
        };
        setup.costs.step = setup.needle.step_length();
        let problem = SteeringProblem::new(setup).unwrap();
        let lattice = problem.lattice();
        let swept = sweep::solve(lattice, rule(1e-3), None).unwrap();
        // Steps may turn so little, or stay so often where they are, that the sweeps take longer than the rule allows.
        prop_assume!(swept.report.status == Status::Converged);
        let proper = ppvi::proper_states(lattice);
        for (value, proper) in swept.values.iter().zip(&proper) {
            prop_assert_eq!(value.is_finite(), *proper);
        }
        let reference = value_iteration(lattice, rule(1e-6), None).unwrap();
        let bound = swept.report.error_bound + reference.report.error_bound + 1e-6;
        for (a, b) in swept.values.iter().zip(&reference.values) {
            prop_assert!(f64::from(*a) == *b || (f64::from(*a) - b).abs() <= bound, "{} against {}", a, b);
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits(setup in setups()) {
        let problem = SteeringProblem::new(setup).unwrap();
        let lattice = problem.lattice();
        let solve = || {
            let solution: LatticeSolution = sweep::solve(lattice, rule(1e-2), None).unwrap();
            let success: Evaluation = evaluation::success(lattice, &solution.policy, Order::Cubic).unwrap();
            let strips: LatticeSolution = sweep::prioritized(lattice, [1, 1], rule(1e-2), None).unwrap();
            let strips = (strips.values, strips.policy, strips.report.residual.to_bits(), strips.report.backups);
            (solution.values, solution.policy, solution.report.residual.to_bits(), success.values, strips)
        };
        let one = on_threads(1, solve);
        for threads in [2, 3, 7] {
            prop_assert!(one == on_threads(threads, solve));
        }
    }

    #[test]
    fn success_is_that_of_the_plain_chain(setup in setups()) {
        let problem = SteeringProblem::new(setup).unwrap();
        let lattice = problem.lattice();
        let solution = sweep::solve(lattice, rule(1e-2), None).unwrap();
        let success = evaluation::success(lattice, &solution.policy, Order::Linear).unwrap();
        prop_assume!(success.converged);
        let plain = evaluate_plainly(lattice, &solution.policy);
        for (a, b) in success.values.iter().zip(&plain) {
            prop_assert!((f64::from(*a) - b).abs() < 1e-4, "{} against {}", a, b);
        }
    }
}
