//! Lattices made by hand: the sweeps against plain value iteration, and the checks of the parts.

use ppvi::lattice::{Costs, HeadingKernel, LatticeMdp, LatticeParts, Region, Shape, Shift, Transition, outcome, sweep};
use ppvi::{Error, Mdp, Status, StopRule, TabularMdp, tabular_sweep, value_iteration};

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
        region_of: Vec::new(),
    }
}

/// The target is the last column.
fn lattice(parts: LatticeParts) -> LatticeMdp {
    let (nx, ny) = (parts.shape.nx, parts.shape.ny);
    LatticeMdp::new(parts, |_, _, codes| {
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
fn every_part_is_checked() {
    let valid = || parts(5, 4, &[1.0]);
    let message = |parts: LatticeParts| match LatticeMdp::new(parts, |_, _, codes| codes.fill(0)) {
        Ok(_) => panic!("must be refused"),
        Err(error) => error.to_string(),
    };
    let with = |change: fn(&mut LatticeParts)| {
        let mut parts = valid();
        change(&mut parts);
        message(parts)
    };
    assert!(LatticeMdp::new(valid(), |_, _, codes| codes.fill(0)).is_ok());
    assert!(with(|parts| parts.shape.ny = 0).starts_with("shape = "));
    assert!(with(|parts| parts.shape.nx = 1 << 40).contains("more than 2^40 states"));
    assert!(with(|parts| parts.spacing[1] = 0.0).starts_with("spacing_mm = 0"));
    assert!(with(|parts| parts.costs.discount = 1.5).starts_with("discount = 1.5"));
    assert!(with(|parts| parts.costs.exit = -1.0).starts_with("exit = -1"));
    assert!(with(|parts| parts.regions[0].step_cost = 0.0).contains("must be positive where the discount is 1"));
    assert!(with(|parts| parts.regions.clear()).starts_with("regions = 0"));
    assert_eq!(with(|parts| parts.regions[0].stencil.truncate(3)), "stencil: expected 4 elements, found 3");
    assert!(with(|parts| parts.regions[0].stencil[2][1].cell = [7, 0]).starts_with("stencil = Shift"));
    assert!(with(|parts| parts.regions[0].stencil[2][1].fraction = [0.0, 1.0]).starts_with("stencil = Shift"));
    assert_eq!(with(|parts| parts.region_of = vec![0; 9]), "region_of: expected 10 elements, found 9");
    assert_eq!(with(|parts| parts.regions.push(parts.regions[0].clone())), "region_of: expected 10 elements, found 0");
    assert!(with(|parts| parts.region_of = vec![1; 10]).starts_with("region_of = 1"));
    let wrong = LatticeMdp::new(valid(), |k, bevel, codes| codes.fill(if (k, bevel) == (2, 1) { 6 } else { 0 }));
    let rule = "must be a code from CONTINUES to AT_TARGET";
    assert_eq!(wrong.err(), Some(Error::parameter("outcomes", "6 at heading 2, bevel index 1", rule)));
}
