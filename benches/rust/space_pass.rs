//! How many states a second does the pass through a volume back up, and does the time grow in proportion to their number?
//!
//! ```text
//! cargo bench -p needleplan-benches --bench space_pass                          # 20 M states on one thread
//! cargo bench -p needleplan-benches --bench space_pass -- 1 2 4 1 6 1 4         # spacing, mm, and of directions, degrees
//! ```
//!
//! The volume has 120 x 80 x 80 mm, six round obstacles and a target of 3 mm radius, the needle a radius of 50 mm. Steps of
//! 8 mm, a noise of 4 degrees a step, eight roll angles and a straight step. Finished slices are counted, not stored.
//! A second row has an organ: a ball of 35 mm radius in which the needle bends with a radius of 40 mm, and prices near
//! obstacles, as anatomies have them. Each row is the fastest of three passes.

use std::time::Instant;

use needle::Straight;
use needle::space::{SpaceCosts, SpaceProblem, SpaceSetup, Volume};
use ppvi::Result;
use ppvi::space::{CollisionGrid, PassOptions, SUCCESS_STEPS, solve_into, voxel};

const STEP_MM: f64 = 8.0;
const TARGET: ([f64; 3], f64) = ([112.0, 42.0, 38.0], 3.0);
const OBSTACLES: [([f64; 3], f64); 6] = [
    ([30.0, 40.0, 40.0], 10.0),
    ([50.0, 20.0, 50.0], 9.0),
    ([50.0, 58.0, 28.0], 9.0),
    ([72.0, 44.0, 56.0], 8.0),
    ([80.0, 40.0, 24.0], 8.0),
    ([96.0, 54.0, 44.0], 6.0),
];

/// The organ, and the radius of the needle's arc in it.
const ORGAN: ([f64; 3], f64) = ([70.0, 40.0, 40.0], 35.0);
const ORGAN_RADIUS: f64 = 40.0;
/// Distance, mm, from obstacles and price of a mm there.
const PRICED: (f64, f32) = (5.0, 0.5);

/// Passes of a row.
const PASSES: usize = 3;

/// The problem with voxels of `spacing` mm and directions that are `degrees` apart.
fn problem(spacing: f64, degrees: f64, has_organ: bool) -> Result<SpaceProblem> {
    let shape = [120.0, 80.0, 80.0].map(|extent: f64| (extent / spacing).round() as usize + 1);
    let within = |at: [f64; 3], (centre, radius): ([f64; 3], f64)| {
        (0..3).map(|axis| (at[axis] - centre[axis]).powi(2)).sum::<f64>() <= radius * radius
    };
    let place = |point: usize| {
        let cell = [point / shape[1] / shape[2], point / shape[2] % shape[1], point % shape[2]];
        cell.map(|cell| cell as f64 * spacing)
    };
    let code = |point: usize| {
        let at = place(point);
        match at {
            _ if within(at, TARGET) => voxel::TARGET,
            _ if OBSTACLES.iter().any(|ball| within(at, *ball)) => voxel::OBSTACLE,
            _ => voxel::FREE,
        }
    };
    let points = shape.iter().product();
    let codes: Vec<u8> = (0..points).map(code).collect();
    let price = |point: usize| {
        let is_near = OBSTACLES.iter().any(|(centre, radius)| within(place(point), (*centre, radius + PRICED.0)));
        if is_near { PRICED.1 } else { 0.0 }
    };
    let (tissues, prices, curvature_radii): (Vec<u8>, _, &[f64]) = if has_organ {
        let tissues = (0..points).map(|point| u8::from(within(place(point), ORGAN))).collect();
        (tissues, (0..points).map(price).collect(), &[50.0, ORGAN_RADIUS])
    } else {
        (vec![], vec![], &[50.0])
    };
    SpaceProblem::new(SpaceSetup {
        volume: Volume::new(CollisionGrid::new(shape, 1, &codes)?, [spacing; 3], tissues, curvature_radii)?,
        advance: (STEP_MM / spacing).round() as usize,
        rolls: 8,
        straight: Some(Straight { curvature_share: 0.0, cost_per_mm: 1.0 }),
        cone: 45f64.to_radians(),
        direction_spacing: degrees.to_radians(),
        noise: 4f64.to_radians() / STEP_MM.sqrt(),
        costs: SpaceCosts { insertion_per_mm: 1.0, rotation: 1.0, collision: 1e4, exit: 1e4 },
        prices,
    })
}

fn main() -> Result<()> {
    let numbers: Vec<f64> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    let grids = if numbers.len() > 1 { numbers } else { vec![2.0, 6.0, 2.0, 4.0] };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a small pool");
    println!("| spacing | directions | organ | states | setup | pass | million states a second | mean success |");
    println!("|--:|--:|---|--:|--:|--:|--:|--:|");
    for (grid, has_organ) in grids.chunks_exact(2).flat_map(|grid| [(grid, false), (grid, true)]) {
        let started = Instant::now();
        let problem = problem(grid[0], grid[1], has_organ)?;
        let (shape, setup) = (problem.mdp().shape(), started.elapsed());
        let (mut success, mut seconds) = (0.0, f64::INFINITY);
        for _ in 0..PASSES {
            success = 0.0;
            let report = pool.install(|| {
                solve_into(problem.mdp(), &PassOptions::default(), None, |solved| {
                    success += solved.success.iter().map(|success| u64::from(*success)).sum::<u64>() as f64;
                    Ok(())
                })
            })?;
            seconds = seconds.min(report.seconds);
        }
        println!(
            "| {} mm | {} | {} | {} | {:.2} s | {seconds:.2} s | {:.1} | {:.6} |",
            grid[0],
            shape.directions,
            if has_organ { "yes" } else { "no" },
            shape.states(),
            setup.as_secs_f64(),
            shape.states() as f64 / seconds / 1e6,
            success / f64::from(SUCCESS_STEPS) / shape.states() as f64,
        );
    }
    Ok(())
}
