//! The proof that no path exists, and an attempt to refute it by sampled paths.

use needle::space::{
    Feasibility, SpaceArc, SpaceCosts, SpaceExecutor, SpacePose, SpaceProblem, SpaceSetup, SpaceVerdict, Volume, bevel,
};
use ppvi::space::{CollisionGrid, PassOptions, solve, voxel};
use rand::SeedableRng;
use rand::rand_core::Rng;
use rand_xoshiro::Xoshiro256PlusPlus;

struct Random(Xoshiro256PlusPlus);

impl Random {
    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }
}

const SHAPE: [usize; 3] = [16, 13, 15];
const CONE: f64 = 0.7;

/// A volume of 30 x 24 x 28 mm with random blocks as obstacles and a target.
fn volume(random: &mut Random) -> Volume {
    let mut codes = vec![voxel::FREE; SHAPE.iter().product()];
    let mut block = |low: [f64; 3], size: f64, code: u8| {
        for (point, known) in codes.iter_mut().enumerate() {
            let at = [point / SHAPE[1] / SHAPE[2], point / SHAPE[2] % SHAPE[1], point % SHAPE[2]];
            if (0..3).all(|axis| at[axis] as f64 >= low[axis] && (at[axis] as f64) < low[axis] + size) {
                *known = code;
            }
        }
    };
    for _ in 0..6 {
        let low = [random.uniform(2.0, 11.0), random.uniform(-2.0, 11.0), random.uniform(-2.0, 13.0)];
        block(low, random.uniform(2.0, 6.0), voxel::OBSTACLE);
    }
    block([12.0, random.uniform(0.0, 10.0), random.uniform(0.0, 12.0)], 2.0, voxel::TARGET);
    let voxels = CollisionGrid::new(SHAPE, 1, &codes).unwrap();
    Volume::new(voxels, [2.0; 3], vec![], &[random.uniform(20.0, 60.0)]).unwrap()
}

/// Whether a random path reaches the target: arcs of any roll angle and of up to the largest curvature, from slice to slice.
fn reaches(volume: &Volume, start: SpacePose, random: &mut Random, aim: [f64; 3]) -> bool {
    let mut pose = start;
    loop {
        let to = [0, 1, 2].map(|axis| aim[axis] - pose.position[axis]);
        let towards = pose.tangent.map(|x| x * to[0].max(1.0) / pose.tangent[0]);
        let aimed = (to[2] - towards[2]).atan2(to[1] - towards[1]);
        let roll = if random.uniform(0.0, 1.0) < 0.7 { aimed } else { random.uniform(0.0, 6.3) };
        let share = random.uniform(0.0, 1.0).sqrt();
        let arc =
            SpaceArc { start: pose, normal: bevel(pose.tangent, roll), curvature: share * volume.curvatures()[0] };
        let Some(length) = arc.length_to(2.0) else { return false };
        for sample in 1..=40 {
            match volume.code(arc.at(length * f64::from(sample) / 40.0).position) {
                voxel::TARGET => return true,
                voxel::FREE => {}
                _ => return false,
            }
        }
        pose = arc.at(length);
        if pose.tangent[0] < CONE.cos() {
            return false;
        }
    }
}

#[test]
fn no_sampled_path_refutes_the_proof() {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(11));
    let (mut reached, mut impossible, mut open) = (0, 0, 0);
    for number in 0..4 {
        let volume = volume(&mut random);
        let proof = Feasibility::new(&volume, CONE, 0.12, 2 + number % 3).unwrap();
        let target = volume.voxels().at_points().iter().position(|code| *code == voxel::TARGET).unwrap();
        let aim = [target / SHAPE[1] / SHAPE[2], target / SHAPE[2] % SHAPE[1], target % SHAPE[2]]
            .map(|cell| 2.0 * cell as f64 + 1.0);
        for _ in 0..800 {
            let slice = (random.uniform(0.0, 6.0) as usize) as f64;
            let position = [2.0 * slice, random.uniform(-1.0, 25.0), random.uniform(-1.0, 29.0)];
            let slopes =
                [1, 2].map(|axis| (aim[axis] - position[axis]) / (aim[0] - position[0]) + random.uniform(-0.4, 0.4));
            let length = (1.0 + slopes[0] * slopes[0] + slopes[1] * slopes[1]).sqrt();
            let start = SpacePose { position, tangent: [1.0, slopes[0], slopes[1]].map(|x| x / length) };
            if volume.code(position) != voxel::FREE || start.tangent[0] < CONE.cos() {
                continue;
            }
            let refused = proof.is_impossible(start);
            let found = (0..4).any(|_| reaches(&volume, start, &mut random, aim));
            assert!(!(refused && found), "volume {number}, {start:?}");
            reached += u32::from(found);
            impossible += u32::from(refused);
            open += u32::from(!refused);
        }
    }
    // Neither the paths nor the proof are empty.
    assert!(reached > 200 && impossible > 50 && open > 200, "{reached} {impossible} {open}");
}

#[test]
fn a_wall_is_a_proof_and_a_hole_in_it_is_none() {
    let walled = |hole: bool| {
        let mut codes = vec![voxel::FREE; SHAPE.iter().product()];
        for (point, code) in codes.iter_mut().enumerate() {
            let at = [point / SHAPE[1] / SHAPE[2], point / SHAPE[2] % SHAPE[1], point % SHAPE[2]];
            if at[0] == 6 && !(hole && at[1..] == [6, 7]) {
                *code = voxel::OBSTACLE;
            }
            if at == [12, 6, 7] {
                *code = voxel::TARGET;
            }
        }
        Volume::new(CollisionGrid::new(SHAPE, 1, &codes).unwrap(), [2.0; 3], vec![], &[40.0]).unwrap()
    };
    let straight = SpacePose { position: [0.0, 12.0, 14.0], tangent: [1.0, 0.0, 0.0] };
    let aside = SpacePose { position: [0.0, 2.0, 4.0], ..straight };
    let between = SpacePose { position: [1.0, 12.0, 14.0], ..straight };
    let proof = |hole| Feasibility::new(&walled(hole), CONE, 0.1, 4).unwrap();
    assert!(proof(false).is_impossible(straight) && !proof(false).is_impossible(between));
    assert!(!proof(true).is_impossible(straight) && proof(true).is_impossible(aside));
    for wrong in [Feasibility::new(&walled(true), 2.0, 0.1, 4), Feasibility::new(&walled(true), CONE, 0.0, 4)] {
        assert!(wrong.is_err());
    }
    assert!(Feasibility::new(&walled(true), CONE, 0.1, 0).is_err());
}

#[test]
fn the_verdict_has_three_answers() {
    let mut random = Random(Xoshiro256PlusPlus::seed_from_u64(3));
    let setup = SpaceSetup {
        volume: volume(&mut random),
        advance: 3,
        rolls: 6,
        straight: None,
        cone: CONE,
        direction_spacing: 0.1,
        noise: 0.005,
        costs: SpaceCosts { insertion_per_mm: 1.0, rotation: 1.0, collision: 1e4, exit: 1e4 },
        prices: vec![],
    };
    let problem = SpaceProblem::new(setup).unwrap();
    let tables = solve(problem.mdp(), &PassOptions::default(), None).unwrap();
    let executor = SpaceExecutor::new(&problem, &tables).unwrap();
    let proof = Feasibility::new(&problem.setup().volume, CONE, 0.1, 3).unwrap();
    let mut counts = [0; 3];
    for _ in 0..400 {
        let position = [0.0, random.uniform(0.0, 24.0), random.uniform(0.0, 28.0)];
        let start = SpacePose { position, tangent: [1.0, random.uniform(-0.6, 0.6), random.uniform(-0.5, 0.5)] };
        let Ok(answer) = executor.look_up(start) else { continue };
        match executor.verdict(start, &proof, 0.5).unwrap() {
            SpaceVerdict::Impossible => counts[0] += usize::from(answer.success < 0.5),
            SpaceVerdict::Possible(success) => counts[1] += usize::from(success >= 0.5 && success == answer.success),
            SpaceVerdict::Undecided => counts[2] += usize::from(answer.success < 0.5),
        }
    }
    assert!(counts.iter().all(|count| *count > 10) && counts.iter().sum::<usize>() > 300, "{counts:?}");
}
