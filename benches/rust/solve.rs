//! How long is a whole solve of 1,176,120 states, by transition, objective and number of threads? How much longer is it
//! with layers of different curvature?

#[path = "../../rust/needle/benches/scene/mod.rs"]
mod scene;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use ppvi::Result;
use ppvi::lattice::{Transition, sweep};
use scene::Objective;

fn solves(criterion: &mut Criterion) -> Result<()> {
    let transitions = [(Transition::Nearest, "nearest"), (Transition::Interpolated, "interpolated")];
    let objectives = [(Objective::Thesis, "thesis"), (Objective::Success, "success")];
    let mut group = criterion.benchmark_group("solve");
    group.sample_size(20);
    for (transition, kind) in transitions {
        for (objective, name) in objectives {
            let problem = scene::problem(1.0, transition, objective)?;
            for threads in [1, 2] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a small pool");
                let id = BenchmarkId::new(format!("{kind}/{name}"), threads);
                let rule = scene::rule()?;
                group.bench_function(id, |bencher| {
                    bencher.iter(|| pool.install(|| sweep::solve(problem.lattice(), rule, None)));
                });
            }
        }
    }
    Ok(())
}

fn layers(criterion: &mut Criterion) -> Result<()> {
    let mut group = criterion.benchmark_group("layers");
    group.sample_size(20);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a small pool");
    for (transition, kind) in [(Transition::Nearest, "nearest"), (Transition::Interpolated, "interpolated")] {
        for count in [0, 4, 12, 30] {
            let problem = scene::layered(1.0, transition, Objective::Thesis, count)?;
            let rule = scene::rule()?;
            group.bench_function(BenchmarkId::new(kind, count), |bencher| {
                bencher.iter(|| pool.install(|| sweep::solve(problem.lattice(), rule, None)));
            });
        }
    }
    Ok(())
}

fn bench(criterion: &mut Criterion) {
    solves(criterion).expect("a valid scene");
    layers(criterion).expect("a valid scene");
}

criterion_group!(benches, bench);
criterion_main!(benches);
