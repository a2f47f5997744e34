//! How long does an explicit sparse problem of 300,120 states take to validate, to solve by directional sweeps, and to
//! solve by plain value iteration? `RAYON_NUM_THREADS` sets the number of threads.

#[path = "../../rust/needle/benches/scene/mod.rs"]
mod scene;

use criterion::{Criterion, criterion_group, criterion_main};
use ppvi::lattice::Transition;
use ppvi::{Result, TabularMdp, tabular_sweep, value_iteration};
use scene::Objective;

fn tabular(criterion: &mut Criterion) -> Result<()> {
    let mdp = TabularMdp::from_mdp(scene::problem(2.0, Transition::Nearest, Objective::Thesis)?.lattice())?;
    let (parts, rule) = (mdp.parts(), scene::rule()?);
    let mut group = criterion.benchmark_group("tabular");
    group.sample_size(10);
    group.bench_function("validate", |bencher| {
        bencher.iter(|| {
            let rows = (parts.action_offsets, parts.row_offsets, parts.stage_costs);
            TabularMdp::new(rows.0, rows.1, parts.successors, parts.probabilities, rows.2, 0.95)
        });
    });
    group.bench_function("sweep", |bencher| bencher.iter(|| tabular_sweep(&mdp, rule, None)));
    group.bench_function("value_iteration", |bencher| bencher.iter(|| value_iteration(&mdp, rule, None)));
    Ok(())
}

fn bench(criterion: &mut Criterion) {
    tabular(criterion).expect("a valid scene");
}

criterion_group!(benches, bench);
criterion_main!(benches);
