//! Solves the needle-steering problem of the thesis (1,176,120 states) in its explicit sparse form, and prints how long
//! every solver takes. `cargo run --release --example tabular_speed [thesis | ssp] [nx ny]`

use std::f64::consts::TAU;
use std::time::Instant;

use ppvi::{Mdp, Partition, PrioritizedOptions, Priority, Solution, StopRule, TabularMdp};

const HEADINGS: usize = 60;
const POINTS: [usize; 2] = [121, 81];
const OBSTACLES: [&[[f64; 2]]; 4] = [
    &[[25.0, 0.0], [40.0, 0.0], [40.0, 22.0], [32.0, 30.0], [25.0, 20.0]],
    &[[30.0, 45.0], [48.0, 42.0], [52.0, 56.0], [40.0, 64.0], [32.0, 58.0]],
    &[[62.0, 15.0], [76.0, 12.0], [80.0, 34.0], [70.0, 40.0], [64.0, 30.0]],
    &[[72.0, 56.0], [84.0, 50.0], [88.0, 66.0], [76.0, 74.0]],
];

#[derive(Clone, Copy, PartialEq)]
enum Event {
    None,
    Exit,
    Collision,
    Target,
}

/// What happens at a point: even-odd rule for the obstacles (their borders do not matter for a speed test).
fn event(x: f64, y: f64) -> Event {
    if !(0.0..=120.0).contains(&x) || !(0.0..=80.0).contains(&y) {
        return Event::Exit;
    }
    let inside = |polygon: &[[f64; 2]]| {
        let edges = (0..polygon.len()).map(|i| (polygon[i], polygon[(i + 1) % polygon.len()]));
        let crossed = |&([ax, ay], [bx, by]): &([f64; 2], [f64; 2])| {
            (ay > y) != (by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax)
        };
        edges.filter(crossed).count() % 2 == 1
    };
    match OBSTACLES.iter().any(|polygon| inside(polygon)) {
        true => Event::Collision,
        false if (x - 100.0).hypot(y - 50.0) <= 2.0 => Event::Target,
        false => Event::None,
    }
}

/// The thesis' costs with discount 0.95, or success-like costs without discount. The last state is the end.
fn needle(discount: f64, rotation: f64, failure: [f64; 2]) -> TabularMdp<'static> {
    let (radius, alpha) = (40.0, TAU / HEADINGS as f64);
    let states = POINTS[0] * POINTS[1] * HEADINGS * 2;
    let noise = [0.027, 0.24, 0.466, 0.24, 0.027];
    let (mut actions, mut rows) = (vec![0], vec![0]);
    let (mut successors, mut probabilities, mut costs) = (Vec::new(), Vec::new(), Vec::new());
    for state in 0..states {
        let (bevel, k) = (state % 2, state / 2 % HEADINGS);
        let (j, i) = (state / 2 / HEADINGS % POINTS[1], state / 2 / HEADINGS / POINTS[1]);
        let (x, y) = (i as f64, j as f64);
        if event(x, y) == Event::None {
            for action in 0..2 {
                let new_bevel = bevel ^ action;
                let sign = if new_bevel == 1 { 1.0 } else { -1.0 };
                let (from, to) = (k as f64 * alpha, (k as f64 + sign) * alpha);
                let (nx, ny) =
                    (x + radius * sign * (to.sin() - from.sin()), y - radius * sign * (to.cos() - from.cos()));
                let (ni, nj) = (nx.round(), ny.round());
                let first = event(nx, ny);
                let outcome = if first == Event::None { event(ni, nj) } else { first };
                let extra = match outcome {
                    Event::Exit => failure[0],
                    Event::Collision => failure[1],
                    _ => 0.0,
                };
                costs.push(radius * alpha + rotation * action as f64 + extra);
                for (m, &p) in noise.iter().enumerate() {
                    let heading = (k + HEADINGS + m + new_bevel * 2 - 3) % HEADINGS;
                    let next = ((ni as usize * POINTS[1] + nj as usize) * HEADINGS + heading) * 2 + new_bevel;
                    let ends = outcome != Event::None;
                    if !ends || m == 0 {
                        successors.push(if ends { states } else { next } as u32);
                        probabilities.push(if ends { 1.0 } else { p });
                    }
                }
                rows.push(successors.len());
            }
        }
        actions.push(costs.len());
    }
    actions.push(costs.len());
    TabularMdp::new(actions, rows, successors, probabilities, costs, discount).expect("a valid problem")
}

/// What anybody would write: Gauss-Seidel over all states, forwards and backwards in turn, on one thread.
fn alternating(mdp: &TabularMdp, threshold: f64) -> (Vec<f64>, usize) {
    let mut values = vec![0.0; mdp.states()];
    for sweep in 1.. {
        let mut largest = 0.0f64;
        let mut update = |state: usize| {
            let mut best = f64::INFINITY;
            for row in mdp.rows(state) {
                let (successors, probabilities, cost) = mdp.row(row);
                let pairs = successors.iter().zip(probabilities);
                let expectation: f64 = pairs.map(|(&next, p)| p * values[next as usize]).sum();
                best = best.min(cost + mdp.discount() * expectation);
            }
            if best < f64::INFINITY {
                largest = largest.max((best - values[state]).abs());
                values[state] = best;
            }
        };
        match sweep % 2 {
            1 => (0..mdp.states()).for_each(&mut update),
            _ => (0..mdp.states()).rev().for_each(&mut update),
        }
        if largest < threshold {
            return (values, sweep);
        }
    }
    unreachable!()
}

fn report(name: &str, clock: Instant, solution: &Solution, reference: &[f64]) {
    let report = &solution.report;
    let worst = solution.values.iter().zip(reference).map(|(a, b)| ppvi::bellman::change(*a, *b)).fold(0.0, f64::max);
    println!(
        "{name:24} {:7.3} s  {} residual {:.1e} bound {:.1e} |V - Vi| {worst:.1e}  {:6.2} n backups  {}/{} partitions processed {} times, {:.2} s + {:.2} s",
        clock.elapsed().as_secs_f64(),
        report.status.name(),
        report.residual,
        report.error_bound,
        report.backups as f64 / solution.values.len() as f64,
        report.order.len(),
        report.partitions,
        report.partitions_processed,
        report.seconds_solving,
        report.seconds_priorities,
    );
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let clock = Instant::now();
    let mdp = match arguments.first().map(String::as_str) {
        Some("ssp") => needle(1.0, 4.0, [10000.0, 10000.0]),
        _ => needle(0.95, 40.0, [100.0, 200.0]),
    };
    println!("{} states, built in {:.3} s", mdp.states(), clock.elapsed().as_secs_f64());
    let rule = StopRule::new(0.01).expect("a valid rule");
    let clock = Instant::now();
    let fast = arguments.iter().any(|argument| argument == "fast");
    let reference = if fast { ppvi::tabular_sweep(&mdp, rule, None) } else { ppvi::value_iteration(&mdp, rule, None) };
    let reference = reference.expect("a valid rule");
    report("value_iteration", clock, &reference, &reference.values);
    for _ in 0..12 {
        let clock = Instant::now();
        let (values, sweeps) = alternating(&mdp, 5e-4);
        println!("alternating Gauss-Seidel {:.3} s {sweeps} sweeps {}", clock.elapsed().as_secs_f64(), values[0]);
        let clock = Instant::now();
        let solution = ppvi::tabular_sweep(&mdp, rule, None).expect("a valid rule");
        report("tabular_sweep", clock, &solution, &reference.values);
    }
    if arguments.iter().any(|argument| argument == "fast") {
        return;
    }
    for grid in [[6, 4], [12, 8], [24, 16]] {
        let place = |s: usize| {
            let point = s.min(mdp.states() - 2) / 2 / HEADINGS;
            [point / POINTS[1], point % POINTS[1]]
        };
        let partition = Partition::grid(mdp.states(), POINTS, grid, place).expect("a valid grid");
        for priority in [Priority::H1, Priority::H2, Priority::Bound] {
            let inner = std::env::var("INNER").ok().and_then(|s| s.parse().ok());
            let inner_sweeps = std::env::var("SWEEPS").ok().and_then(|s| s.parse().ok()).unwrap_or(u64::MAX);
            let options = PrioritizedOptions { priority, inner_tolerance: inner, inner_sweeps };
            let clock = Instant::now();
            let solution = ppvi::prioritized(&mdp, &partition, options, rule, None).expect("valid");
            report(&format!("{} {grid:?}", priority.name()), clock, &solution, &reference.values);
        }
    }
}
