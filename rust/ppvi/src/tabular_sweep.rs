//! The fast solver for explicit problems: directional sweeps over compressed blocks, in deterministic waves.
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use rayon::prelude::*;

use crate::bellman::{Check, certificate, change, solution};
use crate::error::Result;
use crate::mdp::Mdp;
use crate::pattern::{Block, Class, Values};
use crate::proper::proper_states;
use crate::solution::Solution;
use crate::tabular::TabularMdp;
use crate::termination::{Observer, Progress, Status, StopRule, Watch};

/// Values that several threads read and write; who may write what when is the business of the waves.
struct Shared(Vec<AtomicU64>);

impl Values for Shared {
    #[inline]
    fn get(&self, state: usize) -> f64 {
        f64::from_bits(self.0[state].load(Ordering::Relaxed))
    }
}

impl Shared {
    #[inline]
    fn set(&self, state: usize, value: f64) {
        self.0[state].store(value.to_bits(), Ordering::Relaxed);
    }
}

/// Solves.
pub fn tabular_sweep(mdp: &TabularMdp, rule: StopRule, observer: Option<Observer>) -> Result<Solution> {
    rule.validate()?;
    let mut watch = Watch::start(rule, observer);
    let certificate = certificate(mdp);
    let n = mdp.states();
    let t = Instant::now();
    let classes = classify(mdp);
    let mut shift = 12;
    while n >> shift >= 128 {
        shift += 1;
    }
    if let Ok(s) = std::env::var("SHIFT") {
        shift = s.parse().unwrap();
    }
    let blocks: Vec<Block> = (0..n.div_ceil(1 << shift))
        .into_par_iter()
        .map(|b| Block::new(mdp, &classes, b << shift..((b + 1) << shift).min(n), shift))
        .collect();
    eprintln!("compile {:?}", t.elapsed());
    let discount = mdp.discount();
    let values = Shared(
        classes
            .iter()
            .map(|c| AtomicU64::new(if *c == Class::Endless { f64::INFINITY } else { 0.0f64 }.to_bits()))
            .collect(),
    );
    // constants
    let mut policy = vec![0u32; n];
    blocks.par_iter().for_each(|b| b.constants(discount, &values, |s, v| values.set(s, v)));
    eprintln!("init {:?}", t.elapsed());
    let m = blocks.len();
    let mut tasks: Vec<(usize, usize)> = Vec::new();
    if std::env::var("SEQ").is_ok() {
        for b in 0..m {
            tasks.push((b, 0));
        }
        for b in 0..m {
            tasks.push((m - 1 - b, 1));
        }
    } else {
        for b in 0..m {
            tasks.push((b, 0));
            tasks.push((m - 1 - b, 1));
        }
    }
    let conflict = |u: (usize, usize), v: (usize, usize)| {
        u.0 == v.0 || blocks[u.0].reads[u.1].blocks >> v.0 & 1 == 1 || blocks[v.0].reads[v.1].blocks >> u.0 & 1 == 1
    };
    let mut level = vec![0usize; tasks.len()];
    for i in 0..tasks.len() {
        for j in 0..i {
            if conflict(tasks[i], tasks[j]) {
                level[i] = level[i].max(level[j] + 1);
            }
        }
    }
    let waves = level.iter().max().map_or(0, |m| m + 1);
    let mut wave_tasks: Vec<Vec<(usize, usize)>> = vec![vec![]; waves];
    for (i, &l) in level.iter().enumerate() {
        wave_tasks[l].push(tasks[i]);
    }
    eprintln!(
        "blocks {m} waves {waves} list sizes {} {} patterns {}",
        blocks.iter().map(|b| b.lists[0].len()).sum::<usize>(),
        blocks.iter().map(|b| b.lists[1].len()).sum::<usize>(),
        blocks.iter().map(|b| b.count()).sum::<usize>()
    );
    let mut total = vec![0.0f64; m];
    let mut snap = vec![vec![0.0f64; m]; 2 * m];
    let mut left = vec![f64::INFINITY; 2 * m];
    let mut backups = 0u64;
    let mut passes = 0;
    let max_value = 0.0;
    let threshold = certificate.threshold(rule.tolerance, max_value);
    let bound = |u: (usize, usize), total: &[f64], snap: &[Vec<f64>], left: &[f64]| {
        let mut worst = 0.0f64;
        for c in 0..m {
            if blocks[u.0].reads[u.1].blocks >> c & 1 == 1 {
                worst = worst.max(total[c] - snap[u.0 * 2 + u.1][c]);
            }
        }
        left[u.0 * 2 + u.1] + discount * worst
    };
    loop {
        let mut largest = 0.0f64;
        let mut done = 0;
        for wave in &wave_tasks {
            let todo: Vec<_> = wave.iter().copied().filter(|&u| bound(u, &total, &snap, &left) >= threshold).collect();
            let run = |u: (usize, usize)| {
                let block = &blocks[u.0];
                let mut d = 0.0f64;
                for &member in &block.lists[u.1] {
                    let new = block.backup_member(member, discount, &values);
                    d = d.max(change(new, values.get(member.state as usize)));
                    values.set(member.state as usize, new);
                }
                d
            };
            let changes: Vec<f64> = if todo.len() > 1 {
                todo.par_iter().map(|&u| run(u)).collect()
            } else {
                todo.iter().map(|&u| run(u)).collect()
            };
            for (&u, &d) in todo.iter().zip(&changes) {
                done += 1;
                backups += blocks[u.0].lists[u.1].len() as u64;
                total[u.0] += d;
                largest = largest.max(d);
                left[u.0 * 2 + u.1] = if blocks[u.0].reads[u.1].late { discount * d } else { 0.0 };
                snap[u.0 * 2 + u.1].copy_from_slice(&total);
            }
        }
        passes += 1;
        let worst = tasks.iter().map(|&u| bound(u, &total, &snap, &left)).fold(0.0, f64::max);
        eprintln!(
            "pass {passes} largest {largest:.2e} bound {worst:.2e} tasks {done} backups {:.2} t {:?}",
            backups as f64 / n as f64,
            t.elapsed()
        );
        if worst < threshold {
            break;
        }
        if watch.check(&Progress { sweeps: backups as f64 / n as f64, residual: largest, threshold }).is_some() {
            break;
        }
    }
    let mut check = Check { residual: 0.0, max_value: 0.0 };
    let checks: Vec<Check> = blocks
        .par_iter()
        .zip(policy.par_chunks_mut(1 << shift))
        .map(|(b, policy)| {
            let mut check = Check { residual: 0.0, max_value: 0.0 };
            let p0 = b.begin();
            b.each_backup(discount, &values, |s, v, a| {
                policy[s - p0] = a as u32;
                let old = values.get(s);
                check.residual = check.residual.max(change(v, old));
                check.max_value = check.max_value.max(old.abs());
            });
            check
        })
        .collect();
    for c in checks {
        check.residual = check.residual.max(c.residual);
        check.max_value = check.max_value.max(c.max_value);
    }
    backups += n as u64;
    eprintln!("check {:?}", t.elapsed());
    let values: Vec<f64> = values.0.into_iter().map(|v| f64::from_bits(v.into_inner())).collect();
    let mut solution = solution(values, policy, Status::Converged, check, &certificate);
    solution.report.backups = backups;
    eprintln!("end {:?}", t.elapsed());
    Ok(solution)
}

fn classify(mdp: &TabularMdp) -> Vec<Class> {
    let mut classes: Vec<Class> = (0..mdp.states())
        .into_par_iter()
        .map(|s| if mdp.actions(s) == 0 { Class::Absorbing } else { Class::Active })
        .collect();
    if mdp.discount() == 1.0 {
        for (class, proper) in classes.iter_mut().zip(proper_states(mdp)) {
            if !proper {
                *class = Class::Endless;
            }
        }
    }
    classes
}
