//! How long is one pass of the lattice solver over all states? The answer is the slope of the time over the number of
//! passes. The time at zero passes is that of the set-up of the grid and of the final tables.

#[path = "../../rust/needle/benches/scene/mod.rs"]
mod scene;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use ppvi::lattice::{Transition, sweep};
use ppvi::{Result, StopRule};
use scene::Objective;

fn passes(criterion: &mut Criterion) -> Result<()> {
    for (transition, name) in [(Transition::Nearest, "nearest"), (Transition::Interpolated, "interpolated")] {
        let problem = scene::problem(1.0, transition, Objective::Thesis)?;
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool of one thread");
        let mut group = criterion.benchmark_group(format!("sweep_pass/{name}"));
        group.sample_size(30);
        for max_sweeps in [1, 2, 4] {
            let rule = StopRule { max_sweeps, ..StopRule::new(1e-3)? };
            group.throughput(Throughput::Elements(max_sweeps * problem.lattice().shape().states() as u64));
            group.bench_function(BenchmarkId::from_parameter(max_sweeps), |bencher| {
                bencher.iter(|| pool.install(|| sweep::solve(problem.lattice(), rule, None)));
            });
        }
    }
    Ok(())
}

fn bench(criterion: &mut Criterion) {
    passes(criterion).expect("a valid scene");
}

criterion_group!(benches, bench);
criterion_main!(benches);
