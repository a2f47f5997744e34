//! Steering in 3D: tables, look ahead and executions of small volumes agree.

use needle::space::{SpaceAnswer, SpaceCosts, SpaceExecutor, SpacePose, SpaceProblem, SpaceSetup, Volume};
use needle::{Event, Straight};
use ppvi::Order;
use ppvi::space::{CollisionGrid, PassOptions, SpaceTables, solve, voxel};

/// A volume of 40 x 24 x 24 mm with two round obstacles and a round target; `tissues` makes its deeper half bend more.
fn setup(spacing: f64, tissues: bool, noise_deg: f64) -> SpaceSetup {
    refined_setup(spacing, 1, tissues, noise_deg)
}

/// The same with voxels of a fraction of the spacing.
fn refined_setup(spacing: f64, refinement: usize, tissues: bool, noise_deg: f64) -> SpaceSetup {
    let points = [40.0, 24.0, 24.0].map(|extent: f64| (extent / spacing) as usize + 1);
    let place = |number: usize, [_, ny, nz]: [usize; 3]| [number / nz / ny, number / nz % ny, number % nz];
    let (shape, size) = (points.map(|count| count * refinement), spacing / refinement as f64);
    let within = |at: [f64; 3], centre: [f64; 3], radius: f64| {
        (0..3).map(|axis| (at[axis] - centre[axis]).powi(2)).sum::<f64>() <= radius * radius
    };
    let code = |number: usize| match place(number, shape).map(|cell| cell as f64 * size) {
        at if within(at, [36.0, 12.0, 12.0], 3.0) => voxel::TARGET,
        at if within(at, [18.0, 8.0, 14.0], 5.0) || within(at, [24.0, 18.0, 8.0], 4.0) => voxel::OBSTACLE,
        _ => voxel::FREE,
    };
    let codes: Vec<u8> = (0..shape.iter().product()).map(code).collect();
    let tissue = (0..points.iter().product()).map(|point| u8::from(place(point, points)[0] as f64 * spacing > 20.0));
    let volume = Volume::new(
        CollisionGrid::new(points, refinement, &codes).unwrap(),
        [spacing; 3],
        if tissues { tissue.collect() } else { vec![] },
        &[40.0, 30.0],
    );
    SpaceSetup {
        volume: volume.unwrap(),
        advance: (8.0 / spacing) as usize,
        rolls: 8,
        straight: Some(Straight { curvature_share: 0.0, cost_per_mm: 1.0 }),
        cone: 45f64.to_radians(),
        direction_spacing: 5f64.to_radians(),
        noise: noise_deg.to_radians() / 8f64.sqrt(),
        costs: SpaceCosts { insertion_per_mm: 1.0, rotation: 2.0, collision: 1e4, exit: 1e4 },
        prices: vec![],
    }
}

fn solved(setup: SpaceSetup) -> (SpaceProblem, SpaceTables) {
    let problem = SpaceProblem::new(setup).unwrap();
    let tables = solve(problem.mdp(), &PassOptions::default(), None).unwrap();
    (problem, tables)
}

/// An entry on the first slice that points to the target, turned by two slopes.
fn entry([y, z]: [f64; 2], [dy, dz]: [f64; 2]) -> SpacePose {
    SpacePose { position: [0.0, y, z], tangent: [36.0, 12.0 - y + 36.0 * dy, 12.0 - z + 36.0 * dz] }
}

#[test]
fn at_grid_points_the_look_ahead_finds_the_values_of_the_table() {
    for refinement in [1, 3] {
        look_ahead_finds_the_values_of_the_table(refinement);
    }
}

fn look_ahead_finds_the_values_of_the_table(refinement: usize) {
    let setup = refined_setup(2.0, refinement, false, 3.0);
    let (problem, tables) = solved(SpaceSetup { prices: vec![0.25; 21 * 13 * 13], ..setup });
    let executor = SpaceExecutor::new(&problem, &tables).unwrap();
    let (shape, mut compared, mut apart) = (problem.mdp().shape(), 0, 0);
    for state in (0..shape.states()).step_by(97) {
        let [k, j] = [state % shape.nz, state / shape.nz % shape.ny];
        let [direction, slice] = [state / shape.plane() % shape.directions, state / shape.slice_states()];
        let position = [slice, j, k].map(|cell| 2.0 * cell as f64);
        // From a state without success the look ahead still counts the way to fail, for which the table has no number.
        let is_free = problem.setup().volume.code(position) == voxel::FREE;
        if slice == 20 || !is_free || tables.success[state] == 0 {
            continue;
        }
        let pose = SpacePose { position, tangent: problem.directions().tangent(direction) };
        let SpaceAnswer { value, .. } = executor.look_up(pose).unwrap();
        let expected = f64::from(tables.values[state]);
        // A straight path along faces of voxels is in the one or the other by rounding.
        apart += usize::from((value - expected).abs() > 1e-3 * expected);
        compared += 1;
    }
    assert!(compared > 1000 && apart * 500 < compared, "{apart} of {compared}");
}

#[test]
fn decisions_do_not_depend_on_the_action_that_is_tried_first() {
    for tissues in [false, true] {
        let (problem, tables) = solved(setup(2.0, tissues, 4.0));
        let poses: Vec<SpacePose> = (0..300u32)
            .map(|number| {
                let [y, z, dy, dz] = [7, 11, 13, 17].map(|prime| f64::from(number * prime % 97) / 97.0);
                let pose = entry([1.0 + 22.0 * y, 1.0 + 22.0 * z], [0.6 * dy - 0.3, 0.6 * dz - 0.3]);
                SpacePose { position: [f64::from(number % 30), pose.position[1], pose.position[2]], ..pose }
            })
            .collect();
        let answers = SpaceExecutor::new(&problem, &tables).unwrap().look_up_many(&poses).unwrap();
        let decisions: Vec<(usize, f64)> = answers.iter().map(|answer| (answer.action, answer.value)).collect();
        // A first action that costs much leaves more branches of the others to follow.
        for first in 0..9 {
            let others = SpaceTables { policy: vec![first; tables.policy.len()], ..tables.clone() };
            let found = SpaceExecutor::new(&problem, &others).unwrap().decide_many(&poses).unwrap();
            assert!(found == decisions, "{first}");
        }
        assert!((0..9).filter(|action| decisions.iter().any(|(own, _)| own == action)).count() > 6);
    }
}

#[test]
fn executions_are_repeatable_and_end_as_their_start_says() {
    let (problem, tables) = solved(setup(2.0, true, 4.0));
    let executor = SpaceExecutor::new(&problem, &tables).unwrap();
    let pool = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let start = entry([7.0, 13.0], [0.1, -0.05]);
    let runs = |threads, seed| pool(threads).install(|| executor.rollout(start, 60, seed)).unwrap();
    assert!(runs(1, 5) == runs(2, 5) && runs(1, 5) != runs(1, 6));
    assert!(runs(1, 5).iter().all(|run| run.length > 7.0 && run.cost > run.length));
    let inside = SpacePose { position: [36.0, 12.0, 12.0], tangent: [1.0, 0.0, 0.0] };
    assert!(executor.rollout(inside, 2, 0).unwrap().iter().all(|run| run.event == Event::Target && run.length == 0.0));
    assert_eq!(executor.look_up(inside).unwrap(), SpaceAnswer { action: 0, value: 0.0, success: 1.0 });
    for (position, tangent) in [
        ([-2.0, 12.0, 12.0], [1.0, 0.0, 0.0]),
        ([0.0, 12.0, f64::NAN], [1.0, 0.0, 0.0]),
        ([0.0, 12.0, 12.0], [1.0, 1.2, 0.0]),
        ([0.0, 12.0, 12.0], [0.0, 0.0, 0.0]),
    ] {
        assert!(executor.look_up(SpacePose { position, tangent }).is_err());
    }
}

#[test]
fn predictions_are_what_executions_achieve() {
    for (tissues, refinement) in [(false, 1), (true, 4)] {
        let (problem, tables) = solved(refined_setup(2.0, refinement, tissues, 4.0));
        let executor = SpaceExecutor::new(&problem, &tables).unwrap();
        let (mut sum, mut bias, runs) = (0.0, 0.0, 200);
        let entries =
            [[6.0, 6.0], [9.3, 17.1], [12.2, 11.7], [17.9, 8.4], [8.1, 14.3], [15.6, 15.2], [4.4, 10.1], [19.3, 19.8]];
        for (number, at) in entries.into_iter().enumerate() {
            let start = entry(at, [0.04 * number as f64 - 0.15, 0.1 - 0.03 * number as f64]);
            let predicted = executor.look_up(start).unwrap().success;
            let hits =
                executor.rollout(start, runs, 3).unwrap().iter().filter(|run| run.event == Event::Target).count();
            let difference = predicted - hits as f64 / runs as f64;
            assert!(difference.abs() < 0.25, "{start:?}: {predicted}, {hits}");
            (sum, bias) = (sum + difference.abs(), bias + difference);
        }
        // Voxels that are finer than the grid have borders between its points, of which the table sees less than executions.
        let most = if refinement == 1 { [0.05, 0.035] } else { [0.05, 0.05] };
        assert!(sum / 8.0 < most[0] && f64::abs(bias) / 8.0 < most[1], "{sum} {bias}");
    }
}

/// Mean and standard error.
fn mean(numbers: &[f64]) -> [f64; 2] {
    let count = numbers.len() as f64;
    let mean = numbers.iter().sum::<f64>() / count;
    [mean, (numbers.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count / count).sqrt()]
}

#[test]
fn an_estimate_is_what_executions_achieve_whatever_the_table_says() {
    let (problem, tables) = solved(setup(2.0, true, 8.0));
    let success = tables.success.iter().enumerate().map(|(state, _)| (state * 40_503 % 65_536) as u16).collect();
    let wrong = SpaceTables { success, ..tables.clone() };
    let (known, misled) =
        (SpaceExecutor::new(&problem, &tables).unwrap(), SpaceExecutor::new(&problem, &wrong).unwrap());
    for start in
        [entry([6.0, 6.0], [-0.1, 0.1]), entry([12.2, 11.7], [-0.07, 0.04]), entry([15.6, 15.2], [0.05, -0.05])]
    {
        let runs = known.rollout(start, 4000, 3).unwrap();
        let hits: Vec<f64> = runs.iter().map(|run| f64::from(u8::from(run.event == Event::Target))).collect();
        let [realised, error] = mean(&hits);
        assert!((0.05..0.95).contains(&realised), "{realised}");
        let [good, bad] = [known, misled].map(|executor| mean(&executor.estimate(start, 1000, 3).unwrap()));
        for [estimate, its_error] in [good, bad] {
            assert!((estimate - realised).abs() < 4.0 * its_error.hypot(error), "{estimate} {its_error} {realised}");
        }
        // The table makes the estimate more precise than as many executions alone.
        assert!(good[1] < 0.8 * 2.0 * error && good[1] < bad[1], "{good:?} {bad:?} {error}");
    }
    let pool = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let start = entry([7.0, 13.0], [0.1, -0.05]);
    let numbers = |threads, seed| pool(threads).install(|| known.estimate(start, 60, seed)).unwrap();
    assert!(numbers(1, 5) == numbers(2, 5) && numbers(1, 5) != numbers(1, 6));
    let inside = SpacePose { position: [36.0, 12.0, 12.0], tangent: [1.0, 0.0, 0.0] };
    assert_eq!(known.estimate(inside, 2, 0).unwrap(), [1.0; 2]);
    assert!(known.estimate(SpacePose { position: [-2.0, 12.0, 12.0], tangent: [1.0, 0.0, 0.0] }, 1, 0).is_err());
}

#[test]
fn without_noise_a_free_way_is_found_and_costs_what_it_is_long() {
    let (problem, tables) = solved(setup(2.0, false, 0.0));
    let executor = SpaceExecutor::new(&problem, &tables).unwrap();
    for start in [entry([15.6, 15.2], [0.1, 0.0]), entry([19.3, 19.8], [0.1, -0.1])] {
        let run = executor.rollout(start, 1, 0).unwrap()[0];
        assert_eq!(run.event, Event::Target);
        assert!(run.length > 30.0 && run.length < 45.0 && run.cost >= run.length && run.cost < 70.0);
    }
    let linear = PassOptions { success: Order::Linear, ..PassOptions::default() };
    assert_eq!(solve(problem.mdp(), &linear, None).unwrap().values, tables.values);
}

#[test]
fn setups_that_break_a_rule_are_refused() {
    let message = |change: fn(&mut SpaceSetup)| {
        let mut setup = setup(4.0, false, 1.0);
        change(&mut setup);
        SpaceProblem::new(setup).unwrap_err().to_string()
    };
    for (text, name) in [
        (message(|setup| setup.rolls = 0), "rolls"),
        (message(|setup| setup.advance = 0), "advance"),
        (message(|setup| setup.noise = f64::NAN), "tip_noise"),
        (message(|setup| setup.cone = 2.0), "cone_deg"),
        (message(|setup| setup.direction_spacing = 0.0), "direction_spacing_deg"),
        (message(|setup| setup.costs.insertion_per_mm = 0.0), "insertion_per_mm"),
        (message(|setup| setup.costs.exit = -1.0), "exit"),
        (message(|setup| setup.prices = vec![1.0]), "prices"),
        (message(|setup| setup.straight = Some(Straight { curvature_share: 2.0, cost_per_mm: 1.0 })), "straight"),
    ] {
        assert!(text.contains(name), "{text}: {name}");
    }
    let voxels = CollisionGrid::new([2; 3], 1, &[0; 8]).unwrap();
    assert!(Volume::new(voxels.clone(), [1.0; 3], vec![1; 8], &[50.0]).is_err());
    assert!(Volume::new(voxels.clone(), [1.0; 3], vec![0; 7], &[50.0]).is_err());
    assert!(Volume::new(voxels, [1.0, 0.0, 1.0], vec![], &[50.0]).is_err());
}
