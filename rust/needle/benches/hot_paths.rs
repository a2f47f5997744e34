//! Counts the instructions of the hot paths: `benches/guard` runs each under callgrind and compares with its limits.
//!
//! `hot_paths NAME` prepares a path and then calls its function `counted_*`. Only instructions in these functions
//! count. Everything runs on the main thread, because counts belong to threads. Without NAME the program lists the
//! paths.

mod scene;

use std::hint::black_box;

use needle::{Answers, Execution, Executor, Run, SteeringProblem, Table, TableGrid};
use ppvi::lattice::{LatticeMdp, Transition, evaluation, sweep};
use ppvi::{
    Partition, PrioritizedOptions, Priority, Result, StopRule, TabularMdp, prioritized, tabular_sweep, value_iteration,
};
use scene::Objective::{Success, Thesis};

/// The spacing of the grid, mm: 78,120 states.
const SPACING: f64 = 4.0;

const PATHS: [&str; 9] = [
    "classify",
    "solve_nearest",
    "solve_interpolated",
    "success",
    "tabular_sweep",
    "value_iteration",
    "prioritized",
    "look_up",
    "roll_out",
];

// Valgrind finds the functions by these unmangled names.

#[unsafe(no_mangle)]
#[inline(never)]
fn counted_classify() -> Result<SteeringProblem> {
    scene::problem(black_box(SPACING), Transition::Nearest, Thesis)
}

#[unsafe(no_mangle)]
#[inline(never)]
fn counted_solve(lattice: &LatticeMdp, rule: StopRule) -> Result<sweep::LatticeSolution> {
    sweep::solve(lattice, rule, None)
}

#[unsafe(no_mangle)]
#[inline(never)]
fn counted_success(lattice: &LatticeMdp, policy: &[u8]) -> Result<evaluation::Evaluation> {
    evaluation::success(lattice, policy, ppvi::Order::Cubic)
}

#[unsafe(no_mangle)]
#[inline(never)]
fn counted_tabular_sweep(mdp: &TabularMdp, rule: StopRule) -> Result<ppvi::Solution> {
    tabular_sweep(mdp, rule, None)
}

#[unsafe(no_mangle)]
#[inline(never)]
fn counted_value_iteration(mdp: &TabularMdp, rule: StopRule) -> Result<ppvi::Solution> {
    value_iteration(mdp, rule, None)
}

#[unsafe(no_mangle)]
#[inline(never)]
fn counted_prioritized(mdp: &LatticeMdp, partition: &Partition, rule: StopRule) -> Result<ppvi::Solution> {
    let options = PrioritizedOptions { priority: Priority::H2, ..PrioritizedOptions::default() };
    prioritized(mdp, partition, options, rule, None)
}

#[unsafe(no_mangle)]
#[inline(never)]
fn counted_look_up(grid: &TableGrid, poses: &[[f64; 4]], table: &Table) -> Result<Answers> {
    grid.look_up_many(poses, table)
}

#[unsafe(no_mangle)]
#[inline(never)]
fn counted_roll_out(executor: &Executor, start: [f64; 4]) -> Result<Vec<Run>> {
    executor.rollout(&[start], 1000, 7, true, 500)
}

fn run(name: &str) -> Result<()> {
    let rule = scene::rule()?;
    let few = |max_sweeps| StopRule { max_sweeps, ..rule };
    let thesis = |transition| scene::problem(SPACING, transition, Thesis);
    let nearest = || thesis(Transition::Nearest);
    match name {
        "classify" => drop(black_box(counted_classify()?)),
        "solve_nearest" => drop(black_box(counted_solve(nearest()?.lattice(), rule)?)),
        "solve_interpolated" => drop(black_box(counted_solve(thesis(Transition::Interpolated)?.lattice(), rule)?)),
        "tabular_sweep" => drop(black_box(counted_tabular_sweep(&TabularMdp::from_mdp(nearest()?.lattice())?, rule)?)),
        "value_iteration" => {
            drop(black_box(counted_value_iteration(&TabularMdp::from_mdp(nearest()?.lattice())?, few(5))?))
        }
        "prioritized" => {
            let problem = nearest()?;
            let lattice = problem.lattice();
            drop(black_box(counted_prioritized(lattice, &lattice.partition([6, 4])?, few(5))?));
        }
        _ => run_on_a_table(name)?,
    }
    Ok(())
}

/// Runs a path that starts from a solved table.
fn run_on_a_table(name: &str) -> Result<()> {
    let problem = scene::problem(SPACING, Transition::Interpolated, Success)?;
    let lattice = problem.lattice();
    let solved = sweep::solve(lattice, scene::rule()?, None)?;
    match name {
        "success" => drop(black_box(counted_success(lattice, &solved.policy)?)),
        "look_up" => {
            let grid = TableGrid::new(lattice.shape(), [SPACING; 2], problem.setup().workspace.size)?;
            let table = Table { values: &solved.values, policy: &solved.policy, success: &solved.values };
            drop(black_box(counted_look_up(&grid, &scene::poses(50_000), &table)?));
        }
        "roll_out" => {
            let executor = Executor::new(&problem, &solved.policy, &solved.values, Execution::Nearest, None)?;
            drop(black_box(counted_roll_out(&executor, [0.0, 28.0, 0.314, -1.0])?));
        }
        _ => panic!("no path {name:?}; there are {PATHS:?}"),
    }
    Ok(())
}

fn main() -> Result<()> {
    let here = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread();
    here.build_global().expect("no pool has been asked for before");
    match std::env::args().nth(1) {
        Some(name) => run(&name),
        None => {
            println!("{}", PATHS.join("\n"));
            Ok(())
        }
    }
}
