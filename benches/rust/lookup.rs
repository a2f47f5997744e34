//! How long is one look-up, and how many look-ups per second are there in a batch of a million?

#[path = "../../rust/needle/benches/scene/mod.rs"]
mod scene;

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use needle::{Pose, Table, TableGrid};
use ppvi::Result;
use ppvi::lattice::{Transition, sweep};
use scene::Objective;

fn look_up(criterion: &mut Criterion) -> Result<()> {
    let problem = scene::problem(1.0, Transition::Nearest, Objective::Thesis)?;
    let solution = sweep::solve(problem.lattice(), scene::rule()?, None)?;
    // Any numbers will do for the probabilities.
    let table = Table { values: &solution.values, policy: &solution.policy, success: &solution.values };
    let grid = TableGrid::new(problem.lattice().shape(), [1.0; 2], problem.setup().workspace.size)?;
    let poses = scene::poses(1 << 20);
    let mut group = criterion.benchmark_group("lookup");
    let mut next = poses.iter().cycle();
    group.bench_function("one", |bencher| {
        bencher.iter(|| {
            let pose = next.next().expect("an endless cycle");
            grid.index(Pose::of(black_box(*pose))).map(|index| (table.policy[index], table.values[index]))
        });
    });
    group.sample_size(20).throughput(Throughput::Elements(poses.len() as u64));
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a small pool");
        group.bench_function(format!("many/{threads}"), |bencher| {
            bencher.iter(|| pool.install(|| grid.look_up_many(&poses, &table)));
        });
    }
    Ok(())
}

fn bench(criterion: &mut Criterion) {
    look_up(criterion).expect("a valid scene");
}

criterion_group!(benches, bench);
criterion_main!(benches);
