//! The production solver: Gauss-Seidel sweeps against the direction of motion.
//!
//! The headings are cut into four sectors (right, up, left, down, in grid cells). In the sector "right" every step
//! moves to the right, so one sweep over the columns from right to left takes the value of the target through the whole
//! workspace, and likewise in the others. Right and left do not read each other, nor do up and down: they are the two
//! waves of a pass, and the sectors of a wave run side by side. Between waves each sector takes a copy of the few
//! headings beyond its ends (`halo`). Nothing else is shared, so the result does not depend on the number of threads.
//!
//! A pass is n backups, and about five passes are enough where Jacobi sweeps need eighty; see the benches. The last
//! sweeps write the tables as they go.
//!
//! *Start.* V = the cheaper of the two failures, since that is what most of a hard workspace is worth.
//!
//! *Stop.* A value is the exact backup of what it has read, so its residual is at most the discount times the change of
//! that since: within a sector there is none (steps lead downstream), and at the interfaces between sectors it is
//! computed when the halos are refreshed. So a pass knows a bound on the residual of its values for next to nothing,
//! and no pass is spent on proving what the others have done. To it comes the rounding of a backup.
//!
//! *Precision.* Single precision, and double precision from where rounding hides what the tolerance asks for.

use std::time::{Duration, Instant};

use crate::error::Result;
use crate::lattice::engine::{Engine, Tables};
use crate::lattice::kernel::{StageCosts, StepCosts, Vectorized};
use crate::lattice::model::LatticeMdp;
use crate::lattice::parts::{Region, Shift, outcome};
use crate::lattice::terminal_mask::{TerminalMask, terminal_masks};
use crate::mdp::Mdp;
use crate::proper::proper_states;
use crate::solution::Report;
use crate::termination::{Certificate, LimitMonitor, Observer, Progress, Status, StopRule};

/// Multiple of the threshold: once the residual is below it, sweeps write their values to the tables. A sweep divides
/// the residual by five to ten, and the last two sweeps must write their values.
const KEEP_BELOW: f64 = 20.0;

/// A precision is exhausted if the residual is at most this multiple of the rounding of a backup.
const EXHAUSTED: f64 = 4.0;

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

/// The costs of the planning problem itself.
fn planning_costs(lattice: &LatticeMdp) -> StageCosts<f64> {
    let costs = &lattice.parts.costs;
    let at_obstacle = lattice.value_at(outcome::AT_OBSTACLE);
    let step = |region: &Region| {
        let (cost, outside) = (region.step_cost, lattice.value_outside());
        let (collision, exit) = (cost + costs.collision, cost + costs.exit);
        StepCosts { cost, terminal: [0.0, cost, collision, exit, at_obstacle, 0.0, outside, f64::INFINITY] }
    };
    StageCosts {
        rotation: costs.rotation,
        discount: costs.discount,
        steps: lattice.parts.regions.iter().map(step).collect(),
    }
}

/// The terminal masks with the improper states marked, or `None` where there are none: states from which no policy ends
/// the execution with probability one, so that their value is infinite without a discount. A step far shorter than the
/// spacing may round to no movement at all; without such a step all values are finite, and no search is needed. Both
/// bevels of a pose have the same two steps to choose from, so both are improper, and so are both steps.
fn masks_with_improper_states(lattice: &LatticeMdp) -> Option<Vec<TerminalMask>> {
    let stands_still = |shift: &Shift| shift.cell == [0, 0] && shift.fraction == [0.0, 0.0];
    if lattice.discount() < 1.0
        || !lattice.parts.regions.iter().flat_map(|region| &region.stencil).flatten().any(stands_still)
    {
        return None;
    }
    let proper = proper_states(lattice);
    let mut outcomes = lattice.outcomes.clone();
    for (state, _) in proper.iter().enumerate().filter(|(_, proper)| !**proper) {
        let (i, j, k, b) = lattice.coordinates(state);
        outcomes[lattice.outcome_place(i, j, k, b)] = outcome::IMPROPER;
    }
    Some(terminal_masks(&lattice.parts, &lattice.directions, &outcomes))
}

/// A bound on the rounding of one backup of values up to `largest`: of the convolution, the blend of four, discount,
/// cost and turning, each half a unit in the last place.
fn rounding<T: Vectorized>(lattice: &LatticeMdp, largest: f64) -> f64 {
    let taps = lattice.parts.regions.iter().flat_map(|region| &region.turn).map(|turn| turn.taps().len()).max();
    let operations = taps.unwrap_or(0) + 1 + if lattice.is_interpolated() { 4 } else { 0 } + 3;
    operations as f64 * largest * T::EPSILON / 2.0
}

/// Solves the lattice by directional sweeps.
pub fn solve(lattice: &LatticeMdp, rule: StopRule, observer: Option<Observer<'_>>) -> Result<LatticeSolution> {
    rule.validate()?;
    let started = Instant::now();
    let certificate = Certificate { discount: lattice.discount(), least_stage_cost: lattice.least_stage_cost() };
    let mut monitor = LimitMonitor::start(rule, observer);
    // Two waves that write the tables.
    monitor.needs_to_end(2, Duration::ZERO);
    let improper = masks_with_improper_states(lattice);
    let terminal_masks = improper.as_ref().unwrap_or(&lattice.terminal_masks);
    let costs = &lattice.parts.costs;
    let (start, stage_costs) = (costs.exit.min(costs.collision), planning_costs(lattice));
    let dearest_step = lattice.parts.regions.iter().fold(0.0, |most: f64, region| most.max(region.step_cost));
    let mut run = Run {
        lattice,
        rule,
        certificate,
        monitor,
        waves: 0,
        tables: 0,
        largest: costs.exit.max(costs.collision) + dearest_step,
    };
    let mut single = Engine::<f32>::new(lattice, terminal_masks, &stage_costs, start, None);
    let sectors = single.sectors();
    let end = match run.iterate(&mut single) {
        Some(end) => end,
        None => {
            let mut double = Engine::<f64>::new(lattice, terminal_masks, &stage_costs, start, None);
            double.load(&single);
            drop(single);
            let Some(end) = run.iterate(&mut double) else { unreachable!("double precision has no successor") };
            end
        }
    };
    Ok(run.conclude(end, sectors, started))
}

struct Run<'a, 'o> {
    lattice: &'a LatticeMdp,
    rule: StopRule,
    certificate: Certificate,
    monitor: LimitMonitor<'o>,
    waves: u64,
    /// Number of tables that took another pass.
    tables: u64,
    /// Approximate largest value.
    largest: f64,
}

/// Result of an iteration.
struct End {
    status: Status,
    residual: f64,
    tables: Tables,
}

impl Run<'_, '_> {
    /// Makes passes until the residual is small enough, a limit is reached, or the precision exhausted: then None, if
    /// there is a better one.
    fn iterate<T: Vectorized>(&mut self, engine: &mut Engine<'_, T>) -> Option<End> {
        let first = self.waves;
        let mut last = f64::INFINITY;
        loop {
            let threshold = self.certificate.threshold(self.rule.tolerance, self.largest);
            let rounding = rounding::<T>(self.lattice, self.largest);
            let keep = last < KEEP_BELOW * threshold.max(rounding);
            let seen = engine.wave(self.waves % 2 == 1, threshold.max(EXHAUSTED * rounding), keep);
            last = seen;
            self.waves += 1;
            if self.waves == first + 1 {
                // Half of the states have not been looked at in this precision.
                continue;
            }
            let residual = seen + rounding;
            let stopped = self.monitor.check(&Progress { sweeps: self.sweeps(), residual, threshold });
            let exhausted = seen <= EXHAUSTED * rounding;
            if stopped.is_none() && residual >= threshold {
                match exhausted {
                    false => continue,
                    true if T::EPSILON > f64::EPSILON => return None,
                    true => {}
                }
            }
            let tables = engine.tables(threshold);
            self.tables += u64::from(tables.again);
            let largest = tables.largest;
            let threshold = self.certificate.threshold(self.rule.tolerance, largest);
            let rounding = self::rounding::<T>(self.lattice, largest);
            let residual = tables.seen + rounding;
            let exhausted = tables.seen <= EXHAUSTED * rounding;
            self.largest = largest;
            let status = match stopped {
                _ if residual < threshold => Status::Converged,
                Some(status) => status,
                None if !exhausted => continue,
                None if T::EPSILON > f64::EPSILON => return None,
                None => Status::PrecisionLimit,
            };
            return Some(End { status, residual, tables });
        }
    }

    /// Backups so far, in units of n.
    fn sweeps(&self) -> f64 {
        self.waves as f64 / 2.0 + self.tables as f64
    }

    fn conclude(self, end: End, sectors: usize, started: Instant) -> LatticeSolution {
        let End { status, residual, tables } = end;
        // The values returned are rounded to single precision.
        let rounding = tables.largest * f64::from(f32::EPSILON) / 2.0;
        let report = Report {
            status,
            residual,
            error_bound: self.certificate.error_bound(residual, tables.largest) + rounding,
            backups: (self.sweeps() * self.lattice.states() as f64) as u64,
            partitions: sectors,
            partitions_processed: (sectors as f64 * self.sweeps()) as u64,
            order: (0..sectors as u32).collect(),
            seconds_solving: started.elapsed().as_secs_f64(),
            seconds_priorities: 0.0,
        };
        LatticeSolution { values: tables.values, policy: tables.policy, report }
    }
}
