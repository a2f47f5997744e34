//! The four-obstacle workspace of the thesis (120 x 80 mm), on a grid of any spacing.

#![allow(dead_code)]

use needle::{Area, Bicycle, Clearance, Setup, SteeringProblem, Tissues, Workspace};
use ppvi::lattice::{Costs, Transition};
use ppvi::{Result, StopRule};

const OBSTACLES: [&[[f64; 2]]; 4] = [
    &[[25.0, 0.0], [40.0, 0.0], [40.0, 22.0], [32.0, 30.0], [25.0, 20.0]],
    &[[30.0, 45.0], [48.0, 42.0], [52.0, 56.0], [40.0, 64.0], [32.0, 58.0]],
    &[[62.0, 15.0], [76.0, 12.0], [80.0, 34.0], [70.0, 40.0], [64.0, 30.0]],
    &[[72.0, 56.0], [84.0, 50.0], [88.0, 66.0], [76.0, 74.0]],
];

/// The objective.
#[derive(Clone, Copy)]
pub enum Objective {
    /// The costs of the thesis, discount 0.95.
    Thesis,
    /// Success first: a failure costs 10,000, discount 1.
    Success,
}

/// The workspace, solved for one of the objectives; obstacles are tested at four points of an arc.
pub fn problem(spacing: f64, transition: Transition, objective: Objective) -> Result<SteeringProblem> {
    layered(spacing, transition, objective, 0)
}

/// The same workspace with layers of equal depth and different curvature.
pub fn layered(spacing: f64, transition: Transition, objective: Objective, layers: usize) -> Result<SteeringProblem> {
    let depths = (0..layers).map(|layer| (120.0 * layer as f64 / layers as f64, 40.0 + layer as f64)).collect();
    let obstacles = OBSTACLES.iter().map(|points| Area::polygon(points.to_vec())).collect::<Result<_>>()?;
    let needle = Bicycle::new(40.0, 60)?;
    let step = needle.step_length();
    let costs = match objective {
        Objective::Thesis => Costs { step, rotation: 40.0, collision: 200.0, exit: 100.0, discount: 0.95 },
        Objective::Success => Costs { step, rotation: 4.0, collision: 1e4, exit: 1e4, discount: 1.0 },
    };
    SteeringProblem::new(Setup {
        workspace: Workspace::new([120.0, 80.0], obstacles, [100.0, 50.0], 2.0)?,
        needle,
        spacing: [spacing; 2],
        noise: vec![0.466, 0.24, 0.027],
        noise_step: None,
        arc_samples: 4,
        transition,
        costs,
        tissues: Tissues::new(depths, Vec::new())?,
        clearance: Clearance::default(),
        straight: None,
    })
}

/// The stop rule of the thesis: values correct to 0.01.
pub fn rule() -> Result<StopRule> {
    StopRule::new(0.01)
}

/// Reproducible poses, uniform over the workspace.
pub fn poses(count: usize) -> Vec<[f64; 4]> {
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut uniform = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut pose = || {
        let bevel = if uniform() < 0.5 { -1.0 } else { 1.0 };
        [120.0 * uniform(), 80.0 * uniform(), 7.0 * (uniform() - 0.5), bevel]
    };
    (0..count).map(|_| pose()).collect()
}
