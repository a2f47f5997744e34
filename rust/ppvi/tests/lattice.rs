//! Lattices made by hand: the sweeps against plain value iteration, and the checks of the parts.

use ppvi::lattice::{Costs, HeadingKernel, LatticeMdp, LatticeParts, Region, Shape, Shift, Transition, outcome, sweep};
use ppvi::{Error, Mdp, Status, StopRule, Storage, TabularMdp, tabular_sweep, value_iteration};

/// A point that always moves right, whatever its heading.
fn parts(nx: usize, headings: usize, noise: &[f64]) -> LatticeParts {
    let right = Shift { cell: [1, 0], fraction: [0.0; 2] };
    let turn = [-1.0, 1.0].map(|side| HeadingKernel::matched(side, noise, 1.0).unwrap());
    LatticeParts {
        shape: Shape { nx, ny: 2, headings },
        spacing: [1.0; 2],
        transition: Transition::Nearest,
        costs: Costs { step: 2.0, rotation: 1.0, collision: 100.0, exit: 100.0, discount: 1.0 },
        regions: vec![Region { step_length: 1.0, step_cost: 2.0, stencil: vec![[right; 2]; headings], turn }],
        straight: Vec::new(),
        region_of: Vec::new(),
    }
}

/// The target is the last column.
fn lattice(parts: LatticeParts) -> LatticeMdp {
    let (nx, ny) = (parts.shape.nx, parts.shape.ny);
    LatticeMdp::new(parts, |_, _, _, codes| {
        codes.fill(outcome::CONTINUES);
        codes[(nx - 2) * ny..].fill(outcome::TARGET);
        codes[(nx - 1) * ny..].fill(outcome::AT_TARGET);
    })
    .unwrap()
}

#[test]
fn any_number_of_headings_has_the_values_of_the_reference() {
    // With few headings a direction may have none, and sectors of one wave read each other or themselves.
    for headings in [1, 2, 3, 4, 5, 8, 60] {
        for noise in [vec![1.0], vec![0.5, 0.25], vec![0.4, 0.2, 0.1]] {
            for spacing in [[1.0, 1.0], [1.0, 9.0], [9.0, 1.0]] {
                let lattice = lattice(LatticeParts { spacing, ..parts(9, headings, &noise) });
                let rule = StopRule::new(1e-3).unwrap();
                let swept = sweep::solve(&lattice, rule, None).unwrap();
                let reference = value_iteration(&lattice, rule, None).unwrap();
                let rows = tabular_sweep(&TabularMdp::from_mdp(&lattice).unwrap(), rule, None).unwrap();
                assert_eq!(swept.report.status, Status::Converged);
                for state in 0..lattice.states() {
                    let expected = 2.0 * (8 - state / 2 / headings / 2) as f64;
                    for value in [f64::from(swept.values[state]), reference.values[state], rows.values[state]] {
                        assert!(
                            (value - expected).abs() <= 1e-3,
                            "{headings} headings, {noise:?}: {value}, {expected}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn a_noise_of_probability_zero_next_to_infinite_values() {
    // On the second row the point stands still for ever.
    let mut parts = parts(9, 4, &[0.5, 0.0, 0.25]);
    let still = Shift { cell: [0; 2], fraction: [0.0; 2] };
    parts.regions.push(Region { stencil: vec![[still; 2]; 4], ..parts.regions[0].clone() });
    parts.region_of = (0..4 * 18).map(|point| point % 2).collect();
    let lattice = lattice(parts);
    let rule = StopRule { storage: Storage::Single, ..StopRule::new(1e-3).unwrap() };
    let swept = sweep::solve(&lattice, rule, None).unwrap();
    let reference = value_iteration(&lattice, rule, None).unwrap();
    let proper = ppvi::proper_states(&lattice);
    assert!(proper.contains(&true) && proper.contains(&false));
    for report in [&swept.report, &reference.report] {
        assert_eq!(report.status, Status::Converged);
        assert!(report.error_bound <= 1e-3, "{report:?}");
    }
    for (state, proper) in proper.into_iter().enumerate() {
        let (a, b) = (f64::from(swept.values[state]), reference.values[state]);
        assert!(if proper { (a - b).abs() <= 2e-3 } else { a == f64::INFINITY && b == a }, "{state}: {a}, {b}");
    }
}

#[test]
fn turns_back_and_forth_never_end() {
    // A step to the right turns the needle to the left, and the next one back again.
    let mut parts = parts(9, 2, &[1.0]);
    let left = Shift { cell: [-1, 0], fraction: [0.0; 2] };
    parts.regions[0].stencil[1] = [left; 2];
    let codes = |_, heading: usize, _, codes: &mut [u8]| {
        codes.fill(outcome::CONTINUES);
        let at_border = if heading == 0 { 14..16 } else { 0..2 };
        codes[at_border].fill(if heading == 0 { outcome::TARGET } else { outcome::EXIT });
        codes[16..].fill(outcome::AT_TARGET);
    };
    let lattice = LatticeMdp::new(parts, codes).unwrap();
    let rule = StopRule::new(1e-3).unwrap();
    let swept = sweep::solve(&lattice, rule, None).unwrap();
    let reference = value_iteration(&lattice, rule, None).unwrap();
    assert_eq!(swept.report.status, Status::Converged);
    assert!(swept.values.contains(&f32::INFINITY));
    assert_eq!(swept.values, reference.values.iter().map(|value| *value as f32).collect::<Vec<f32>>());
}

#[test]
fn every_part_is_checked() {
    let valid = || parts(5, 4, &[1.0]);
    let message = |parts: LatticeParts| match LatticeMdp::new(parts, |_, _, _, codes| codes.fill(0)) {
        Ok(_) => panic!("must be refused"),
        Err(error) => error.to_string(),
    };
    let with = |change: fn(&mut LatticeParts)| {
        let mut parts = valid();
        change(&mut parts);
        message(parts)
    };
    let last_leaves = |codes: &mut [u8]| {
        codes.fill(outcome::CONTINUES);
        codes[8..].fill(outcome::EXIT);
    };
    assert!(LatticeMdp::new(valid(), |_, _, _, codes| last_leaves(codes)).is_ok());
    let beyond = LatticeMdp::new(valid(), |_, k, bevel, codes| {
        last_leaves(codes);
        codes[9] = if (k, bevel) == (3, 0) { outcome::CONTINUES } else { outcome::EXIT };
    });
    let rule = "must be another code, such as EXIT, where a step ends beyond the grid";
    let found = "CONTINUES at point (4, 1), heading 3, bevel index 0";
    assert_eq!(beyond.err(), Some(Error::parameter("outcomes", found, rule)));
    assert!(with(|parts| parts.shape.ny = 0).starts_with("shape = "));
    assert!(with(|parts| parts.shape.nx = 1 << 40).contains("more than 2^40 states"));
    assert!(with(|parts| parts.spacing[1] = 0.0).starts_with("spacing_mm = 0"));
    assert!(with(|parts| parts.costs.discount = 1.5).starts_with("discount = 1.5"));
    assert!(with(|parts| parts.costs.exit = -1.0).starts_with("exit = -1"));
    let rule = "must not be negative, and at most 1e20: tables are in single precision";
    for cost in [1e300, 1.1e20, f64::INFINITY, f64::NAN] {
        let mut parts = valid();
        parts.costs.collision = cost;
        assert_eq!(message(parts), format!("collision = {cost}: {rule}"));
        let mut parts = valid();
        parts.regions[0].step_cost = cost;
        assert_eq!(message(parts), format!("insertion_per_mm = {cost}: {rule}"));
    }
    assert!(with(|parts| parts.regions[0].step_cost = 0.0).contains("must be positive where the discount is 1"));
    assert!(with(|parts| parts.regions.clear()).starts_with("regions = 0"));
    assert_eq!(with(|parts| parts.regions[0].stencil.truncate(3)), "stencil: expected 4 elements, found 3");
    assert!(with(|parts| parts.regions[0].stencil[2][1].cell = [7, 0]).starts_with("stencil = Shift"));
    assert!(with(|parts| parts.regions[0].stencil[2][1].fraction = [0.0, 1.0]).starts_with("stencil = Shift"));
    assert_eq!(with(|parts| parts.region_of = vec![0; 39]), "region_of: expected 40 elements, found 39");
    assert_eq!(with(|parts| parts.regions.push(parts.regions[0].clone())), "region_of: expected 40 elements, found 0");
    assert!(with(|parts| parts.region_of = vec![1; 40]).starts_with("region_of = 1"));
    let wrong = LatticeMdp::new(valid(), |_, k, bevel, codes| codes.fill(if (k, bevel) == (2, 1) { 6 } else { 3 }));
    let rule = "must be a code from CONTINUES to AT_TARGET";
    assert_eq!(wrong.err(), Some(Error::parameter("outcomes", "6 at heading 2, bevel index 1", rule)));
}
