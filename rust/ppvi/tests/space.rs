//! Small volumes: the backward pass against explicit rows, any number of threads, and the checks of the parts.

mod cases;

use std::ops::ControlFlow;
use std::time::Duration;

use cases::random::Random;
use ppvi::space::{
    Branch, CollisionGrid, FailureCosts, PassOptions, SUCCESS_STEPS, SpaceMdp, SpaceParts, SpaceShape, SpaceStep,
    SpaceTables, solve, solve_into, voxel,
};
use ppvi::{Error, Mdp, Order, Status, StopFlag, StopRule, TabularMdp, value_iteration};

const LINEAR: PassOptions = PassOptions { success: Order::Linear, time_limit: None };

/// A random path between two slices of voxels, on the way to the voxel of a landing in the slice `end`.
fn path(random: &mut Random, end: usize, slices: [usize; 2], near: [i32; 2]) -> Vec<[i32; 3]> {
    let mut path = vec![];
    for slice in slices[0]..=slices[1] {
        let share = slice as f64 / end as f64;
        let at = near.map(|end| (share * f64::from(end)).round() as i32);
        if random.chance(70) && slice > 0 {
            path.push([slice as i32, at[0], at[1]]);
        }
    }
    path
}

fn branch(random: &mut Random, directions: usize, column: (i32, f64), rest: usize) -> Branch {
    let fraction = if random.chance(30) { 0.0 } else { random.uniform(0.0, 0.999) };
    let (cell, fraction) = ([random.below(5) as i32 - 2, column.0], [fraction, column.1]);
    Branch { direction: random.below(directions) as u32, weight: random.uniform(0.01, 1.0), rest, cell, fraction }
}

/// A random rest of a path, to the voxel of the landing of a branch.
fn rest(random: &mut Random, advance: usize, refinement: usize, branch: &Branch) -> Vec<[i32; 3]> {
    let (near, end) = (branch.voxel(refinement), advance * refinement);
    let mut path = path(random, end, [end.div_ceil(2), end], near);
    path.push([end as i32, near[0], near[1]]);
    path
}

fn step(random: &mut Random, advance: usize, directions: usize, refinement: usize) -> SpaceStep {
    let lost = if random.chance(70) { 0.0 } else { random.uniform(0.0, 0.5) };
    let (cost, length) = (random.uniform(0.5, 3.0), random.uniform(0.5, 2.0));
    let spread = [0, 1].map(|_| if random.chance(50) { 0.0 } else { random.uniform(0.0, 0.1) });
    let (ends, end) =
        ([0, 1].map(|_| random.below(5 * refinement) as i32 - 2 * refinement as i32), advance * refinement);
    let path = path(random, end, [0, end / 2], ends);
    if random.chance(8) {
        return SpaceStep { cost, length, path, rests: vec![], branches: vec![], lost: 1.0, spread };
    }
    // Some branches share a column of landings.
    let column = |random: &mut Random| (random.below(5) as i32 - 2, random.uniform(0.0, 0.999));
    let (first, second) = (column(random), column(random));
    let number = 1 + random.below(4);
    let mut branches: Vec<Branch> =
        (0..number).map(|n| branch(random, directions, if 2 * n < number { first } else { second }, n)).collect();
    let rests = branches.iter().map(|branch| rest(random, advance, refinement, branch)).collect();
    if number > 1 && random.chance(30) {
        // Two branches that share a path, and so the voxel of their landing.
        (branches[1].rest, branches[1].cell, branches[1].fraction) = (0, branches[0].cell, branches[0].fraction);
    }
    let sum: f64 = branches.iter().map(|branch| branch.weight).sum();
    branches.iter_mut().for_each(|branch| branch.weight /= sum);
    SpaceStep { cost, length, path, rests, branches, lost, spread }
}

/// A small volume, some of its parts left out.
fn parts(seed: u64) -> SpaceParts {
    let random = &mut Random(seed);
    // Rows of more than a word of bits, and more rows than a block has.
    let is_tall = seed % 10 == 9;
    let nz = random.one_of(if is_tall { &[1, 3, 9] } else { &[1, 3, 9, 63, 64, 70] });
    let ny = if is_tall { 66 } else { 1 + random.below(6) };
    let shape = SpaceShape { slices: 2 + random.below(5), ny, nz, directions: 1 + random.below(4) };
    let (advance, actions, regions) = (1 + random.below(3), 1 + random.below(4), 1 + random.below(3));
    let points = shape.slices * shape.plane();
    let rarely = random.one_of(&[0, 5, 30]);
    let refinement = if seed.is_multiple_of(2) { 1 } else { 1 + random.below(3) };
    let count = points * refinement.pow(3);
    let mut voxels: Vec<u8> =
        (0..count).map(|_| if random.chance(rarely) { 1 + random.below(3) as u8 } else { voxel::FREE }).collect();
    voxels[count - 1 - random.below(shape.plane() * refinement.pow(2))] = voxel::TARGET;
    let voxels = CollisionGrid::new([shape.slices, ny, nz], refinement, &voxels).unwrap();
    let look = (0..shape.directions).map(|_| [0, 1, 2].map(|_| random.below(5) as i32 - 2)).collect();
    let looks = random.chance(50);
    SpaceParts {
        shape,
        advance,
        costs: FailureCosts { collision: random.uniform(10.0, 300.0), exit: random.uniform(10.0, 300.0) },
        voxels,
        look: if looks { look } else { vec![] },
        regions: (0..regions)
            .map(|_| {
                (0..shape.directions * actions).map(|_| step(random, advance, shape.directions, refinement)).collect()
            })
            .collect(),
        region_of: if regions > 1 { (0..points).map(|_| random.below(regions) as u8).collect() } else { vec![] },
        prices: if random.chance(40) { (0..points).map(|_| random.uniform(0.0, 1.0) as f32).collect() } else { vec![] },
    }
}

/// Probability that the policy succeeds, from the rows of the same problem with free steps and failures that cost 1.
fn success_of(parts: &SpaceParts, policy: &[u8]) -> Vec<f64> {
    let mut parts = SpaceParts { costs: FailureCosts { collision: 1.0, exit: 1.0 }, prices: vec![], ..parts.clone() };
    parts.regions.iter_mut().flatten().for_each(|step| step.cost = 1e-30);
    let mdp = SpaceMdp::new(parts).unwrap();
    let mut failure = vec![0.0; mdp.states()];
    for state in (0..mdp.states()).rev() {
        failure[state] = match mdp.actions(state) {
            0 => mdp.absorbing_value(state),
            _ => mdp.q_value(state, usize::from(policy[state]), &failure),
        };
    }
    failure.into_iter().map(|failure| 1.0 - failure).collect()
}

#[test]
fn the_pass_has_the_values_of_explicit_rows() {
    let mut compared = 0;
    for seed in 0..150 {
        let parts = parts(seed);
        let mdp = SpaceMdp::new(parts.clone()).unwrap();
        let tables = solve(&mdp, &LINEAR, None).unwrap();
        let rows = TabularMdp::from_mdp(&mdp).unwrap();
        let reference = value_iteration(&rows, StopRule::new(1e-6).unwrap(), None).unwrap();
        let success = success_of(&parts, &tables.policy);
        for (state, success) in success.into_iter().enumerate() {
            let (value, expected) = (f64::from(tables.values[state]), reference.values[state]);
            assert!((value - expected).abs() <= 1e-5 * expected + 1e-5, "seed {seed}, {state}: {value}, {expected}");
            let chance = f64::from(tables.success[state]) / f64::from(SUCCESS_STEPS);
            assert!((chance - success).abs() < 2e-5, "seed {seed}, {state}: {chance}, {success}");
            if mdp.actions(state) > 0 {
                // Another action at most where both cost the same.
                let q = mdp.q_value(state, usize::from(tables.policy[state]), &reference.values);
                assert!(q - expected <= 1e-5 * expected + 1e-5);
                compared += 1;
            }
        }
    }
    assert!(compared > 10_000);
}

#[test]
fn cubic_success_keeps_costs_policy_and_certain_success() {
    for seed in 0..40 {
        let mdp = SpaceMdp::new(parts(seed)).unwrap();
        let (linear, cubic) =
            (solve(&mdp, &LINEAR, None).unwrap(), solve(&mdp, &PassOptions::default(), None).unwrap());
        assert!(linear.values == cubic.values && linear.policy == cubic.policy);
        // Where nothing fails in the linear pass, nothing does in the other.
        if linear.success.iter().all(|success| *success == SUCCESS_STEPS) {
            assert_eq!(linear.success, cubic.success);
        }
    }
}

/// A volume that is large enough for several threads: straight and oblique steps with noise on 9 directions.
fn wide() -> SpaceMdp {
    let shape = SpaceShape { slices: 12, ny: 14, nz: 17, directions: 9 };
    let step = |number: usize| {
        let (direction, action) = (number / 3, number % 3);
        let [y, z] = [direction / 3, direction % 3].map(|side| 0.7 * (side as f64 - 1.0));
        let turned = (direction + action + 8) % 9;
        let branch = |side: usize| {
            let landing = [y, z + 0.3 * (action as f64 - 1.0) + 0.2 * (side as f64 - 1.0)];
            let (cell, fraction) = (landing.map(|x| x.floor() as i32), landing.map(|x| x - x.floor()));
            let (direction, weight) = ((turned + side + 8) % 9, [0.2, 0.6, 0.2][side]);
            Branch { direction: direction as u32, weight, rest: side, cell, fraction }
        };
        let branches: Vec<Branch> = (0..3).map(branch).collect();
        let near = |branch: &Branch, axis: usize| branch.cell[axis] + i32::from(branch.fraction[axis] >= 0.5);
        let rests = branches.iter().map(|branch| vec![[2, near(branch, 0), near(branch, 1)]]).collect();
        SpaceStep { cost: 1.0, length: 1.0, path: vec![[1, 0, 0]], rests, branches, lost: 0.0, spread: [0.02; 2] }
    };
    let mut voxels = vec![voxel::FREE; shape.slices * shape.plane()];
    for (point, code) in voxels.iter_mut().enumerate() {
        let [s, j, k] = [point / shape.plane(), point / shape.nz % shape.ny, point % shape.nz];
        if s > 9 && j > 5 && j < 9 && k > 6 && k < 11 {
            *code = voxel::TARGET;
        } else if s == 6 && j + k < 14 {
            *code = voxel::OBSTACLE;
        }
    }
    SpaceMdp::new(SpaceParts {
        shape,
        advance: 2,
        costs: FailureCosts { collision: 1e4, exit: 1e4 },
        voxels: CollisionGrid::new([shape.slices, shape.ny, shape.nz], 1, &voxels).unwrap(),
        regions: vec![(0..27).map(step).collect()],
        region_of: vec![],
        look: vec![],
        prices: vec![],
    })
    .unwrap()
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let mdp = wide();
    let bits = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let SpaceTables { values, policy, success, .. } =
            pool.install(|| solve(&mdp, &PassOptions::default(), None)).unwrap();
        (values.iter().map(|value| value.to_bits()).collect::<Vec<_>>(), policy, success)
    };
    let first = bits(1);
    assert!(first.2.iter().any(|success| *success > 0 && *success < SUCCESS_STEPS));
    assert!(first == bits(2) && first == bits(3));
}

#[test]
fn an_interrupted_pass_has_finished_the_deepest_slices() {
    let mdp = wide();
    let whole = solve(&mdp, &LINEAR, None).unwrap();
    assert_eq!((whole.report.status, whole.report.first_slice), (Status::Converged, 0));
    assert_eq!(whole.report.backups, mdp.states() as u64);
    let mut calls = 0;
    let mut observer = |progress: &ppvi::Progress| {
        calls += 1;
        if progress.sweeps >= 0.5 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let part = solve(&mdp, &LINEAR, Some(&mut observer)).unwrap();
    assert_eq!((part.report.status, part.report.first_slice, calls), (Status::Interrupted, 6, 6));
    let from = 6 * mdp.shape().slice_states();
    assert!(part.values[from..] == whole.values[from..] && part.values[..from].iter().all(|value| *value == 0.0));
    let limited = PassOptions { time_limit: Some(Duration::ZERO), ..LINEAR };
    let limited = solve(&mdp, &limited, None).unwrap();
    assert_eq!((limited.report.status, limited.report.first_slice), (Status::TimeLimit, 11));
    let stop = StopFlag::new();
    stop.raise();
    assert_eq!(stop.guard(|| solve(&mdp, &LINEAR, None)).err(), Some(Error::Stopped));
    let refused = solve_into(&mdp, &LINEAR, None, |solved| match solved.slice {
        8 => Err(Error::parameter("disk", "full", "must have room")),
        _ => Ok(()),
    });
    assert!(refused.is_err_and(|error| error.to_string().contains("disk")));
}

#[test]
fn parts_that_break_a_rule_are_refused() {
    let good = parts(3);
    assert!(good.validate().is_ok());
    let first = |change: fn(&mut SpaceStep)| {
        let mut parts = good.clone();
        let step = parts.regions[0].iter_mut().find(|step| !step.branches.is_empty());
        change(step.unwrap());
        parts
    };
    for (wrong, name) in [
        (SpaceParts { advance: 0, ..good.clone() }, "advance"),
        (SpaceParts { voxels: CollisionGrid::new([3, 1, 1], 1, &[0; 3]).unwrap(), ..good.clone() }, "voxels"),
        (SpaceParts { regions: vec![], ..good.clone() }, "actions"),
        (SpaceParts { region_of: vec![9; good.voxels.at_points().len()], ..good.clone() }, "region_of"),
        (SpaceParts { look: vec![[0; 3]; 50], ..good.clone() }, "look"),
        (SpaceParts { prices: vec![f32::NAN; good.voxels.at_points().len()], ..good.clone() }, "prices"),
        (SpaceParts { costs: FailureCosts { collision: -1.0, exit: 1.0 }, ..good.clone() }, "collision"),
        (SpaceParts { shape: SpaceShape { slices: 0, ..good.shape }, ..good.clone() }, "shape"),
        (SpaceParts { shape: SpaceShape { slices: 1 << 39, ..good.shape }, ..good.clone() }, "bytes"),
        (first(|step| step.cost = 0.0), "cost something"),
        (first(|step| step.lost = 1.1), "sum to one"),
        (first(|step| step.branches[0].weight += 0.1), "sum to one"),
        (first(|step| step.spread[0] = 2.0), "spread"),
        (first(|step| step.branches[0].direction = 99), "directions"),
        (first(|step| step.branches[0].fraction[0] = 1.0), "fractions"),
        (first(|step| step.branches[0].cell[1] += 1), "landing"),
        (first(|step| step.rests[0][0][0] = -1), "slice of its start"),
        (first(|step| step.branches[0].rest = 9), "landing"),
    ] {
        let message = SpaceMdp::new(wrong).unwrap_err().to_string();
        assert!(message.contains(name), "{message}: {name}");
    }
}
