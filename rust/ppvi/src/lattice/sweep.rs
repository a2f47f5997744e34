//! The production solver: Gauss-Seidel sweeps against the direction of motion.
//!
//! The headings are cut into four sectors (right, up, left, down, in grid cells). In the sector "right" every step
//! moves to the right, so one sweep over the columns from right to left takes the value of the target through the whole
//! workspace, and likewise in the others. Right and left do not read each other, nor do up and down: they are the two
//! waves of a pass, and the sectors of a wave run side by side. Between waves each sector takes a copy of the few
//! headings beyond its ends (`halo`). Nothing else is shared, so the result does not depend on the number of threads.
//!
//! A pass is n backups, and about five passes are enough where Jacobi sweeps need eighty; see the benches. The last
//! sweeps write the tables as they go. [`prioritized`] makes the same sweeps, but backs up only the strips whose inputs
//! have changed, and writes the tables at the end.
//!
//! *Start.* V = the cheaper of the two failures, since that is what most of a hard workspace is worth.
//!
//! *Stop.* A value is the backup of what it has read, so its residual is at most the discount times the change of that
//! since: within a sector there is none if steps lead downstream, and at the interfaces between sectors it is computed
//! when the halos are refreshed ([`crate::lattice`]'s `pending` has the proof). So a pass knows a bound on the residual of
//! its values for next to nothing, and no pass is spent on proving what the others have done. The rounding of a backup is
//! added, and the rounding of the numbers of the problem to the precision of the sweep. While the solve goes on, large
//! changes are computed from a sample. Before a solve ends, all changes are computed; if a limit ends it, one more pass
//! writes the tables.
//!
//! *Precision.* Single precision, and double precision from where rounding hides what the tolerance asks for. If that
//! is certain from the start, the change comes early: an error that remains of the start value is the smaller the more
//! sectors it has crossed, and falls faster and faster, but rounding errors are everywhere. Double precision needs as many waves
//! to remove the rounding errors of single precision as to reduce a residual a thousand times as large ([`ROUGH`]).
//!
//! *Improper states.* Steps that may lead to a state of infinite value are marked, and have the finite cost [`NEVER`]:
//! infinity times a weight of zero is no number.

use std::time::Duration;

use crate::bellman::{Check, larger};
use crate::error::{Error, Result};
use crate::lattice::engine::{Engine, Tables};
use crate::lattice::kernel::{StageCosts, StepCosts, Vectorized};
use crate::lattice::model::LatticeMdp;
use crate::lattice::parts::{LatticeParts, Motion, Region, STRAIGHT, Shape, Shift, outcome};
use crate::lattice::terminal_mask::{TerminalMask, terminal_masks};
use crate::lattice::turns::Turns;
use crate::mdp::Mdp;
use crate::memory::is_granted;
use crate::partition::Partition;
use crate::proper::proper_states;
use crate::solution::Report;
use crate::stop::StopFlag;
use crate::termination::{Certificate, LimitMonitor, Observer, Progress, Status, StopRule, Storage};

/// Multiple of the threshold: once the residual is below it, sweeps write their values to the tables. A sweep divides
/// the residual by five to ten, and the last two sweeps must write their values.
const KEEP_BELOW: f64 = 20.0;

/// Multiple of the threshold of single precision: once the residual is below it, double precision takes over, if single
/// precision cannot prove the tolerance. Later changes spare no waves in double precision.
const ROUGH: f64 = 1000.0;

/// Table of a lattice, as `[i][j][heading][bevel]`.
#[derive(Debug, Clone, PartialEq)]
pub struct LatticeSolution {
    /// Cost-to-go in single precision.
    pub values: Vec<f32>,
    /// 0 insert, 1 rotate then insert, 2 insert straight.
    pub policy: Vec<u8>,
    /// Counts and proofs.
    pub report: Report,
}

/// The costs of the planning problem itself.
pub(crate) fn planning_costs(lattice: &LatticeMdp) -> StageCosts<f64> {
    let costs = &lattice.parts.costs;
    let at_obstacle = lattice.value_at(outcome::AT_OBSTACLE);
    let step = |region: &Region| {
        let (cost, outside) = (region.step_cost, lattice.value_outside());
        let (collision, exit) = (cost + costs.collision, cost + costs.exit);
        StepCosts { cost, terminal: [0.0, cost, collision, exit, at_obstacle, 0.0, outside, NEVER] }
    };
    StageCosts { rotation: costs.rotation, discount: costs.discount, steps: lattice.parts.steps().map(step).collect() }
}

/// Cost that stands for infinity during the sweeps, far above all sums of costs. It is also the value of improper states,
/// which only steps of this cost and interpolations with weight zero read.
const NEVER: f64 = 1e36;

/// The terminal masks with the steps marked that may lead to improper states, or `None` where there are none: states
/// from which no policy ends the execution with probability one, so that their value is infinite without a discount. The
/// search takes about as long as a sweep, and is left out where [`always_ends`] knows the answer.
fn masks_with_improper_states(lattice: &LatticeMdp) -> Option<Vec<TerminalMask>> {
    if lattice.discount() < 1.0 || always_ends(&lattice.parts) {
        return None;
    }
    let proper = proper_states(lattice);
    if proper.iter().all(|proper| *proper) {
        return None;
    }
    let (mut outcomes, stop) = (lattice.outcomes.clone(), StopFlag::current());
    for state in (0..lattice.states()).filter(|state| lattice.actions(*state) > 0) {
        stop.check();
        let (i, j, k, b) = lattice.coordinates(state);
        // The actions that arrive with the bevel of the state: one for each motion.
        for motion in lattice.parts.motions() {
            let action = if *motion == Motion::Curved { 0 } else { usize::from(STRAIGHT) };
            let mut leads_astray = false;
            lattice.for_each_successor(state, action, |next, _| leads_astray |= !proper[next]);
            if leads_astray {
                outcomes[lattice.outcome_place(*motion, i, j, k, b)] = outcome::IMPROPER;
            }
        }
    }
    Some(terminal_masks(&lattice.parts, &lattice.directions, &outcomes))
}

/// Whether every step moves and turns little, so that all values are finite: a policy that steers towards one axis and
/// then along it arrives at the border. False where this is not certain.
fn always_ends(parts: &LatticeParts) -> bool {
    let stands_still = |shift: &Shift| shift.cell == [0, 0] && shift.fraction == [0.0, 0.0];
    // An eighth of a full turn: beside it, a step along an axis could round to one across.
    let most = (parts.shape.headings / 8) as i32;
    let steers = |region: &Region| {
        let [(low, high), (other_low, other_high)] = region.turn.each_ref().map(|kernel| {
            let taps = kernel.taps();
            (taps.first().map_or(0, |tap| tap.0), taps.last().map_or(0, |tap| tap.0))
        });
        let both_ways = (low <= 0 && other_high >= 0) || (other_low <= 0 && high >= 0);
        both_ways && [low, high, other_low, other_high].iter().all(|cell| cell.abs() <= most)
    };
    parts.regions.iter().all(|region| steers(region) && !region.stencil.iter().flatten().any(stands_still))
}

/// The certificate of a sweep in the precision T.
///
/// All terms of a backup are positive, so the relative errors of the operations on a value add up. These operations are
/// those of the convolution with the kernel of a turn, the discount, the cost and the rotation; with interpolation also
/// a product and two sums. The weights of the kernel and of the interpolation and the discount are rounded as well. A
/// change of W is a weighted sum of the differences of values, one for each tap beyond the sector. The kernel that needs
/// most counts.
pub(crate) fn certificate<T: Vectorized>(lattice: &LatticeMdp) -> Certificate {
    let turns = Turns::<T>::new(&lattice.parts);
    let of_kernel = turns.all().map(|(_, _, kernel)| {
        let beyond: Vec<f64> = kernel.taps.iter().filter(|tap| tap.0 != 0).map(|tap| tap.1.widen()).collect();
        kernel.operations() as f64 + (beyond.len() + 1) as f64 * beyond.iter().sum::<f64>()
    });
    let operations = of_kernel.fold(0.0, larger) + if lattice.is_interpolated() { 9.0 } else { 5.0 };
    let unit = T::EPSILON / 2.0;
    let underflow =
        operations * if T::EPSILON > f64::EPSILON { f64::from(f32::from_bits(1)) } else { f64::from_bits(1) };
    Certificate { rounding: operations * unit / (1.0 - operations * unit), underflow, ..Certificate::of(lattice) }
}

/// Solves the lattice by directional sweeps over all states.
///
/// # Errors
/// Those of [`StopRule::validate`].
pub fn solve(lattice: &LatticeMdp, rule: StopRule, observer: Option<Observer<'_>>) -> Result<LatticeSolution> {
    run(lattice, rule, observer, None)
}

/// Solves the lattice by prioritized partitions: directional sweeps that back up only the strips of eight grid points
/// whose priority is high.
///
/// The priority is [`Priority::Bound`](crate::Priority::Bound): an upper bound on the residual, accumulated from the
/// changes of what a strip reads. It needs no backups. Sweeps save backups in this way, but not always time, because
/// they have to store more; the result has the same bits on any number of threads. The report counts visits to the
/// partitions of a regular grid of `[px, py]` blocks of grid points, as in the thesis.
///
/// # Errors
/// [`Error::Parameter`] if the number of partitions along an axis is zero or larger than the number of points,
/// [`Error::TooLarge`] if the memory does not hold W of all states; those of [`StopRule::validate`].
pub fn prioritized(
    lattice: &LatticeMdp,
    partitions: [usize; 2],
    rule: StopRule,
    observer: Option<Observer<'_>>,
) -> Result<LatticeSolution> {
    let Shape { nx, ny, .. } = lattice.shape();
    Partition::check_grid([nx, ny], partitions)?;
    // W of every kernel is stored for all states, in single precision and then in double precision beside it.
    let (states, kernels) = (lattice.states() as u128, Turns::<f32>::new(&lattice.parts).count() as u128);
    let needed_bytes = states * kernels * 12;
    if !is_granted(needed_bytes) {
        let rule = "more than the memory with this method; use sweeps over all states or a coarser grid";
        return Err(Error::TooLarge { states, needed_bytes, rule });
    }
    run(lattice, rule, observer, Some(partitions))
}

fn run(
    lattice: &LatticeMdp,
    rule: StopRule,
    observer: Option<Observer<'_>>,
    partitions: Option<[usize; 2]>,
) -> Result<LatticeSolution> {
    // Values of the first engine are stored as they are.
    let rule = StopRule { storage: Storage::Double, ..rule };
    let mut monitor = LimitMonitor::start(rule, certificate::<f32>(lattice), observer)?;
    // Two waves that write the tables, which takes longer, and all changes.
    monitor.needs_to_end(3, Duration::ZERO);
    let improper = masks_with_improper_states(lattice);
    let terminal_masks = improper.as_ref().unwrap_or(&lattice.terminal_masks);
    let costs = &lattice.parts.costs;
    let (start, stage_costs) = (costs.exit.min(costs.collision), planning_costs(lattice));
    let dearest_step = lattice.parts.steps().fold(0.0, |most: f64, region| most.max(region.step_cost));
    let mut run = Run {
        lattice,
        monitor,
        partitions,
        has_improper: improper.is_some(),
        backups: 0,
        visits: 0,
        largest: costs.exit.max(costs.collision) + dearest_step,
    };
    let mut single = Engine::<f32>::new(lattice, terminal_masks, &stage_costs, start, None, partitions.is_some());
    let sectors = single.sectors();
    let end = match run.iterate(&mut single) {
        Some(end) => end,
        None => {
            let mut double =
                Engine::<f64>::new(lattice, terminal_masks, &stage_costs, start, None, partitions.is_some());
            double.load(&single);
            drop(single);
            run.monitor.change_precision(certificate::<f64>(lattice), Storage::Single);
            let Some(end) = run.iterate(&mut double) else { unreachable!("double precision has no successor") };
            end
        }
    };
    Ok(run.conclude(end, sectors))
}

struct Run<'a, 'o> {
    lattice: &'a LatticeMdp,
    monitor: LimitMonitor<'o>,
    /// The numbers of partitions along x and y, if sweeps leave out strips.
    partitions: Option<[usize; 2]>,
    /// Whether some values stand for infinity; see [`NEVER`].
    has_improper: bool,
    /// Number of states that earlier engines have backed up.
    backups: u64,
    /// Number of visits to partitions.
    visits: u64,
    /// Approximate largest value.
    largest: f64,
}

/// Result of an iteration.
struct End {
    status: Status,
    check: Check,
    tables: Tables,
}

impl Run<'_, '_> {
    /// Makes waves until the residual is small enough, a limit is reached, or the precision exhausted: then None, if
    /// there is a better one.
    fn iterate<T: Vectorized>(&mut self, engine: &mut Engine<'_, T>) -> Option<End> {
        // Of the last two waves.
        let mut last = [f64::INFINITY; 2];
        // Whether a residual below the rounding of a backup is tried.
        let mut deeper = false;
        for wave in 0u64.. {
            let threshold = self.monitor.threshold(self.largest);
            let aim = if deeper { self.monitor.least_aim(self.largest).min(threshold) } else { threshold };
            // Single precision writes no values if it cannot prove the tolerance.
            let proves = T::EPSILON <= f64::EPSILON
                || self.monitor.is_within_reach(Check { residual: 0.0, max_value: self.largest });
            let seen = engine.wave(wave % 2 == 1, aim, proves && last[1] < KEEP_BELOW * threshold);
            if let Some(partitions) = self.partitions {
                self.visits += engine.visits(partitions);
            }
            let falls = seen < last[0] / 2.0;
            last = [last[1], seen];
            if wave == 0 {
                // Half of the states have not been looked at in this precision.
                continue;
            }
            let sweeps = self.sweeps(engine.backups());
            let stopped = self.monitor.check(&Progress { sweeps, residual: seen, threshold });
            let check = Check { residual: seen, max_value: self.largest };
            let is_rough = !proves && larger(last[0], last[1]) < ROUGH * threshold;
            let is_open = stopped.is_none() && !is_rough && !self.monitor.is_final(check);
            if is_open && (seen >= aim || self.monitor.becomes_strict(check)) {
                continue;
            }
            if stopped.is_none() && T::EPSILON > f64::EPSILON && !self.monitor.is_proven(check) {
                // Rounding is mostly far below its bound.
                if falls && self.monitor.is_within_reach(check) {
                    deeper = true;
                    continue;
                }
                break;
            }
            let tables = engine.tables();
            self.largest = self.largest(&tables);
            let check = Check { residual: tables.seen, max_value: self.largest };
            match self.monitor.conclude(check, stopped) {
                Some(Status::PrecisionLimit) if T::EPSILON > f64::EPSILON => break,
                Some(status) => {
                    self.backups += engine.backups();
                    return Some(End { status, check, tables });
                }
                None => {}
            }
        }
        self.backups += engine.backups();
        None
    }

    /// The largest finite value.
    fn largest(&self, tables: &Tables) -> f64 {
        if !self.has_improper {
            return tables.largest;
        }
        let finite = tables.values.iter().copied().map(f64::from).filter(|value| *value < NEVER / 2.0);
        finite.fold(0.0, f64::max)
    }

    /// Backups so far, in units of n, with those of the present engine.
    fn sweeps(&self, present: u64) -> f64 {
        (self.backups + present) as f64 / self.lattice.states() as f64
    }

    fn conclude(self, end: End, sectors: usize) -> LatticeSolution {
        let End { status, check, mut tables } = end;
        let (residual, error_bound) = self.monitor.bounds(check);
        let residual = residual + self.monitor.certificate().hidden(check.max_value);
        if self.has_improper {
            let improper = tables.values.iter_mut().filter(|value| **value >= NEVER as f32 / 2.0);
            improper.for_each(|value| *value = f32::INFINITY);
        }
        let (order, partitions_processed) = match self.partitions {
            // The first sweep visits all partitions, from right to left.
            Some([columns, rows]) => {
                let column = |a: usize| (0..rows).map(move |b| (a * rows + b) as u32);
                ((0..columns).rev().flat_map(column).collect(), self.visits)
            }
            None => ((0..sectors as u32).collect::<Vec<u32>>(), (sectors as f64 * self.sweeps(0)) as u64),
        };
        let report = Report {
            status,
            residual,
            error_bound,
            backups: self.backups,
            partitions: order.len(),
            partitions_processed,
            order,
            seconds_solving: self.monitor.seconds(),
            seconds_priorities: 0.0,
        };
        LatticeSolution { values: tables.values, policy: tables.policy, report }
    }
}
