//! The production solver: Gauss-Seidel sweeps against the direction of motion.
//!
//! The headings are cut into four sectors (right, up, left, down, in grid cells). In the sector "right" every step moves
//! to the right, so one sweep over the columns from right to left takes the value of the target through the whole
//! workspace, and likewise in the others. Right and left do not read each other, nor do up and down: they are the two
//! waves of a pass, and the sectors of a wave run side by side. Between waves each sector takes a copy of the few
//! headings beyond its ends (`halo`). Nothing else is shared, so the result does not depend on the number of threads.
//!
//! A pass is n backups, and about five passes are enough where Jacobi sweeps need eighty; see the benches.
//!
//! *Start.* V = the cheaper of the two failures, since that is what most of a hard workspace is worth.
//!
//! *Stop.* A value read during a pass differs from the value after it by at most the largest change d of that pass, so
//! the residual after it is at most discount * d; it is far less, as most reads are of values already final. When d comes
//! close to the threshold the exact residual is computed, in double precision, together with the greedy policy.
//!
//! *Precision.* Single precision until the change is as small as that can show, double precision from there on if the
//! tolerance asks for it.

use std::time::Instant;

use crate::error::Result;
use crate::lattice::bellman::{Greedy, greedy};
use crate::lattice::engine::Engine;
use crate::lattice::field::Field;
use crate::lattice::kernel::Numbers;
use crate::lattice::real::Real;
use crate::lattice::{LatticeMdp, Shift, outcome};
use crate::mdp::Mdp;
use crate::proper::proper_states;
use crate::solution::Report;
use crate::termination::{Certificate, Observer, Progress, Status, StopRule, Watch};

/// The exact residual is computed when the change is below this many thresholds: on the problems of the benches the
/// residual is 5 to 25 times smaller than the change.
const CHECK_BELOW: f64 = 20.0;

/// A precision is exhausted when the change is this many units in the last place of the largest value.
const NOISE_ULPS: f64 = 32.0;

/// Table of a lattice, as `[i][j][heading][bevel]`.
#[derive(Debug, Clone, PartialEq)]
pub struct LatticeSolution {
    /// Cost-to-go in single precision.
    pub values: Vec<f32>,
    /// 0 insert, 1 rotate then insert.
    pub policy: Vec<u8>,
    /// Counts and proofs.
    pub report: Report,
}

/// The numbers of the planning problem itself.
fn planning_numbers(lattice: &LatticeMdp) -> Numbers<f64> {
    let c = &lattice.setup.costs;
    let at_obstacle = lattice.value_at(outcome::AT_OBSTACLE);
    let ended = [0.0, c.step, c.step + c.collision, c.step + c.exit, at_obstacle, 0.0, lattice.value_outside()];
    Numbers { step: c.step, rotation: c.rotation, discount: c.discount, ended }
}

/// The states from which no policy surely ends, which have an infinite value without a discount: a step far shorter than
/// the spacing may round to no movement at all. Every other lattice is finite, and needs no search.
fn endless_states(lattice: &LatticeMdp) -> Option<Field<u8>> {
    let stands_still = |shift: &Shift| shift.cell == [0, 0] && shift.fraction == [0.0, 0.0];
    if lattice.discount() < 1.0 || !lattice.stencil.iter().flatten().any(stands_still) {
        return None;
    }
    let endless: Vec<u8> = proper_states(lattice).into_iter().map(|proper| u8::from(!proper)).collect();
    endless.contains(&1).then(|| Field::of_table(lattice.shape, &endless))
}

/// Solves the lattice by directional sweeps.
pub fn solve(lattice: &LatticeMdp, rule: StopRule, observer: Option<Observer<'_>>) -> Result<LatticeSolution> {
    rule.validate()?;
    let started = Instant::now();
    let certificate = Certificate { discount: lattice.discount(), least_stage_cost: lattice.least_stage_cost() };
    let watch = Watch::start(rule, observer);
    let endless = endless_states(lattice);
    let mut run = Run { lattice, rule, certificate, watch, passes: 0, checks: 0, sectors: 0, endless };
    let end = match run.iterate::<f32>(None) {
        (End::Exhausted, field) => run.iterate::<f64>(Some(&field)).0,
        (end, _) => end,
    };
    Ok(run.conclude(end, started))
}

struct Run<'a, 'o> {
    lattice: &'a LatticeMdp,
    rule: StopRule,
    certificate: Certificate,
    watch: Watch<'o>,
    passes: u64,
    checks: u64,
    sectors: usize,
    endless: Option<Field<u8>>,
}

/// Everything about the values an iteration ended with.
struct Final {
    status: Status,
    greedy: Greedy,
    max_value: f64,
}

enum End {
    Done(Final),
    /// The precision cannot show a smaller residual.
    Exhausted,
}

impl Run<'_, '_> {
    fn iterate<T: Real>(&mut self, from: Option<&Field<f32>>) -> (End, Field<T>) {
        let costs = &self.lattice.setup.costs;
        let start = costs.exit.min(costs.collision);
        let mut engine = Engine::<T>::new(self.lattice, &planning_numbers(self.lattice), start, None);
        if let Some(endless) = &self.endless {
            engine.exclude(endless);
        }
        if let Some(field) = from {
            engine.load(field);
        }
        self.sectors = engine.sectors();
        let mut max_value = costs.exit.max(costs.collision) + costs.step;
        loop {
            let change = engine.pass();
            self.passes += 1;
            let threshold = self.certificate.threshold(self.rule.tolerance, max_value);
            let progress = Progress { sweeps: (self.passes + self.checks) as f64, residual: change, threshold };
            let stopped = self.watch.check(&progress);
            let noise = NOISE_ULPS * T::EPSILON * max_value;
            if stopped.is_none() && change > (CHECK_BELOW * threshold).max(noise) {
                continue;
            }
            let field = engine.field(self.lattice);
            max_value = field.max();
            let threshold = self.certificate.threshold(self.rule.tolerance, max_value);
            let exhausted = change <= noise && T::EPSILON > f64::EPSILON;
            if stopped.is_none() && exhausted && CHECK_BELOW * threshold < noise {
                return (End::Exhausted, field);
            }
            let greedy = greedy(self.lattice, &field);
            self.checks += 1;
            let status = match stopped {
                _ if greedy.residual < threshold => Some(Status::Converged),
                Some(status) => Some(status),
                None if exhausted => return (End::Exhausted, field),
                None if change <= noise => Some(Status::PrecisionLimit),
                None => None,
            };
            if let Some(status) = status {
                return (End::Done(Final { status, greedy, max_value }), field);
            }
        }
    }

    fn conclude(self, end: End, started: Instant) -> LatticeSolution {
        let End::Done(Final { status, greedy, max_value }) = end else {
            unreachable!("double precision does not end as exhausted");
        };
        // The values returned are rounded to single precision.
        let rounding = max_value * f64::from(f32::EPSILON) / 2.0;
        let report = Report {
            status,
            residual: greedy.residual,
            error_bound: self.certificate.error_bound(greedy.residual, max_value) + rounding,
            backups: (self.passes + self.checks) * self.lattice.states() as u64,
            partitions: self.sectors,
            partitions_processed: self.sectors as u64 * self.passes,
            order: (0..self.sectors as u32).collect(),
            seconds_solving: started.elapsed().as_secs_f64(),
            seconds_priorities: 0.0,
        };
        LatticeSolution { values: greedy.values, policy: greedy.policy, report }
    }
}
