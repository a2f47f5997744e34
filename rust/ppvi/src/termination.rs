//! Stop rules, the error bounds that a Bellman residual proves, and the limit monitor of all solvers.
//!
//! # What is proved
//!
//! Let V be the returned values, T the Bellman operator in exact arithmetic, and e an upper bound on |TV - V|. A solver
//! computes |TV - V| with rounding, and [`Certificate`] adds what that can hide:
//!
//! * the rounding of a backup, at most `rounding` * (max |V| + e);
//! * the distance of T from the operator T' whose rows are divided by their sums, at most `discount` * `excess` * max |V|.
//!   Rows may deviate from a sum of one by `excess`, at most 1e-9. All bounds hold for the solutions of T and of T'.
//!
//! *Discount g < 1.* T is a contraction by g (1 + `excess`), so |V - V*| <= e / (1 - g (1 + `excess`)).
//!
//! *Discount 1, V >= 0, and stage costs of at least c > e (a stochastic shortest-path problem).* Scale V by 1 + h with
//! h >= e / (c - e):
//!
//! ```text
//! T((1 + h) V) <= (1 + h) TV - h c <= (1 + h) (V + e) - h c <= (1 + h) V
//! ```
//!
//! U >= TU implies U >= V*, hence V* <= (1 + h) V. In the same way L = (1 - h) V satisfies L <= TL. Follow an optimal
//! policy for k steps: L - V* is at most its expectation after k steps, which tends to 0, because the expected number of
//! steps is at most V* / c. Therefore |V - V*| <= V e / (c - e). The proof needs no sums of rows.
//!
//! *Steps of cost zero.* Let the rank of a state be the largest number of consecutive steps of cost zero from it, R the
//! largest rank, and m the smallest positive cost. Replace V(s) by V(s) + p(s), with p(s) = rank(s) m / (R + 1), and the
//! costs c(s, a) by c(s, a) + p(s) - sum of p(s' | s, a) p(s'). This changes neither residuals nor policies, and all
//! costs are now at least m / (R + 1). [`TabularMdp`](crate::TabularMdp) refuses loops of such steps, where R is
//! infinite.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use crate::bellman::Check;
use crate::error::{Error, Result};
use crate::mdp::Mdp;
use crate::stop::StopFlag;

/// Largest threshold, as a part of the smallest stage cost c. A residual near c proves nothing, and the residual of
/// V = 0 is equal to c.
const MOST_OF_LEAST_COST: f64 = 0.5;

/// Values are as good as their precision allows if the residual is at most this multiple of the rounding of a backup.
const EXHAUSTED: f64 = 4.0;

/// Factor on computed bounds, for the rounding of their own formulas.
const UPWARD: f64 = 1.0 + 1e-12;

/// How a solve ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// The error bound is at most the tolerance.
    Converged,
    /// The limit on sweeps was reached first. Solvers without sweeps count n backups as one sweep.
    IterationLimit,
    /// The time limit was reached first.
    TimeLimit,
    /// No further sweeps can prove the tolerance: the residual is as small as rounding allows, the values are stored in
    /// too low a precision, or the problem allows no bound.
    PrecisionLimit,
    /// The progress callback stopped the solve.
    Interrupted,
}

impl Status {
    /// The name in files and in Python.
    pub fn name(self) -> &'static str {
        match self {
            Status::Converged => "converged",
            Status::IterationLimit => "iteration_limit",
            Status::TimeLimit => "time_limit",
            Status::PrecisionLimit => "precision_limit",
            Status::Interrupted => "interrupted",
        }
    }
}

/// The precision in which the caller stores the values of a [`Solution`](crate::Solution).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Storage {
    /// As the solver returns them.
    #[default]
    Double,
    /// Rounded to single precision.
    Single,
}

/// Tolerance and limits of a solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopRule {
    /// Wanted bound on |V - V*|, in units of cost.
    pub tolerance: f64,
    /// Largest number of sweeps. Solvers without sweeps count n backups as one sweep.
    pub max_sweeps: u64,
    /// Wall-clock time by which the solve should end. No sweep is begun after which it would probably end later, with the
    /// pass at the end that computes policy and residual. The first sweep and this pass are made in any case.
    pub time_limit: Option<Duration>,
    /// Residual and error bound are those of the values stored in this precision.
    pub storage: Storage,
}

impl StopRule {
    /// Makes a rule with at most 100,000 sweeps and no time limit, for values in double precision.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a tolerance that is not positive and finite.
    pub fn new(tolerance: f64) -> Result<Self> {
        let rule = StopRule { tolerance, max_sweeps: 100_000, time_limit: None, storage: Storage::Double };
        rule.validate()?;
        Ok(rule)
    }

    /// Checks the fields.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a tolerance that is not positive and finite, or for zero sweeps.
    pub fn validate(&self) -> Result<()> {
        if !(self.tolerance > 0.0 && self.tolerance.is_finite()) {
            return Err(Error::parameter("tolerance", self.tolerance, "must be positive and finite"));
        }
        if self.max_sweeps == 0 {
            return Err(Error::parameter("max_sweeps", self.max_sweeps, "must be at least 1"));
        }
        Ok(())
    }
}

/// Progress of a solve, for the callback.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Sweeps so far; n backups count as one.
    pub sweeps: f64,
    /// Largest change or residual of the last sweep, in units of cost. It may be an estimate.
    pub residual: f64,
    /// Residual below which the solve ends.
    pub threshold: f64,
}

/// Progress callback, called after every sweep, also after every inner sweep over a partition. `Break` stops the solve.
pub type Observer<'a> = &'a mut (dyn FnMut(&Progress) -> ControlFlow<()> + Send);

/// The numbers of a problem and of a precision that determine what a residual proves; see the [module](self).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Certificate {
    /// Discount factor, in (0, 1].
    pub discount: f64,
    /// Smallest stage cost, after the potential is added. Used with discount 1 only.
    pub least_stage_cost: f64,
    /// Largest potential that is added for steps of cost zero.
    pub potential: f64,
    /// Largest deviation of the sum of a row from one, for rows that do not end the execution.
    pub excess: f64,
    /// Bound on the rounding of a backup, relative to the values.
    pub rounding: f64,
    /// Bound on the rounding of a backup of tiny numbers (underflow).
    pub underflow: f64,
}

impl Certificate {
    /// The certificate of a problem that is solved in double precision.
    pub fn of(mdp: &impl Mdp) -> Self {
        let facts = mdp.facts();
        // Products, sums, discount, cost, and the difference to the old value. With costs of both signs the terms of a
        // sum may be larger than the sum.
        let operations = (facts.longest_row + 6) as f64 * if mdp.discount() < 1.0 { 3.0 } else { 1.0 };
        let unit = f64::EPSILON / 2.0;
        Certificate {
            discount: mdp.discount(),
            least_stage_cost: facts.least_stage_cost,
            potential: facts.potential,
            excess: facts.excess + (facts.longest_row + 1) as f64 * unit,
            rounding: operations * unit,
            underflow: operations * f64::from_bits(1),
        }
    }

    /// Returns the residual below which every value is correct to `tolerance`, but for rounding. If nothing can be
    /// proven (discount 1 and a stage cost that is not positive), returns `tolerance` itself.
    pub fn threshold(&self, tolerance: f64, max_value: f64) -> f64 {
        if self.discount < 1.0 {
            (1.0 - self.discount) * tolerance
        } else if self.least_stage_cost > 0.0 {
            let relative = tolerance / (max_value.max(0.0) + self.potential + tolerance);
            self.least_stage_cost * relative.min(MOST_OF_LEAST_COST)
        } else {
            tolerance
        }
    }

    /// Returns what a residual of zero, as computed, may hide: rounding and sums of rows.
    pub fn hidden(&self, max_value: f64) -> f64 {
        (self.rounding + self.discount * self.excess) * max_value + self.underflow
    }

    /// Returns the residual up to which more sweeps improve the values.
    pub fn floor(&self, max_value: f64) -> f64 {
        EXHAUSTED * self.hidden(max_value)
    }

    /// Returns the upper bound on max |V - V*| that the computed residual of V proves, or infinity if it proves
    /// nothing. `max_value` is the largest finite |V|.
    pub fn error_bound(&self, residual: f64, max_value: f64) -> f64 {
        let residual = (residual * (1.0 + self.rounding) + self.hidden(max_value)) * UPWARD;
        let (divisor, size) = if self.discount < 1.0 {
            (1.0 - self.discount * (1.0 + self.excess), 1.0)
        } else {
            (self.least_stage_cost - residual, max_value + self.potential)
        };
        let bound = size * residual / divisor * UPWARD;
        // Not a number: an infinite or undefined residual proves nothing.
        if divisor > 0.0 && bound >= 0.0 { bound } else { f64::INFINITY }
    }
}

/// Decides when a solve ends, and what is then proved: the one place for limits, progress, thresholds and statuses.
pub struct LimitMonitor<'a> {
    rule: StopRule,
    certificate: Certificate,
    /// Whether the threshold allows for rounding, because the plain one did not suffice.
    strict: bool,
    started: Instant,
    /// Time of the last check.
    checked: Option<Instant>,
    /// The longest time between two checks.
    between: Duration,
    /// Time from the last check at which a limit ends the solve to its end: in times between two checks, and besides.
    to_end: (u32, Duration),
    observer: Option<Observer<'a>>,
    stop: StopFlag,
}

impl<'a> LimitMonitor<'a> {
    /// Checks the rule and starts the clock.
    ///
    /// # Errors
    /// Those of [`StopRule::validate`].
    pub fn start(rule: StopRule, certificate: Certificate, observer: Option<Observer<'a>>) -> Result<Self> {
        rule.validate()?;
        Ok(LimitMonitor {
            rule,
            certificate,
            strict: false,
            started: Instant::now(),
            checked: None,
            between: Duration::ZERO,
            to_end: (0, Duration::ZERO),
            observer,
            stop: StopFlag::current(),
        })
    }

    /// Tells how long the solver needs to its end after a limit is reached: `checks` times as long as from one check to
    /// the next, and `besides`.
    pub(crate) fn needs_to_end(&mut self, checks: u32, besides: Duration) {
        self.to_end = (checks, besides);
    }

    /// Goes on in another precision.
    pub(crate) fn change_precision(&mut self, certificate: Certificate, storage: Storage) {
        self.certificate = certificate;
        self.rule.storage = storage;
        self.strict = false;
    }

    /// The numbers that the bounds of this solve follow from.
    pub fn certificate(&self) -> &Certificate {
        &self.certificate
    }

    /// Largest error that storing a value adds.
    fn storage_error(&self, max_value: f64) -> f64 {
        match self.rule.storage {
            Storage::Double => 0.0,
            Storage::Single => max_value * f64::from(f32::EPSILON) / 2.0 + f64::from(f32::from_bits(1)),
        }
    }

    /// The residual that proves the tolerance, rounding and storage included; not positive if none does.
    fn sufficient(&self, max_value: f64) -> f64 {
        let Certificate { discount, excess, .. } = self.certificate;
        let tolerance = (self.rule.tolerance - self.storage_error(max_value)).max(0.0);
        let plain = match discount < 1.0 {
            true => (1.0 - discount * (1.0 + excess)) * tolerance,
            false => self.certificate.threshold(tolerance, max_value),
        };
        // Less the rounding of this formula.
        (1.0 - 1e-9) * plain - self.certificate.hidden(max_value)
    }

    /// The residual to aim at, for values up to `max_value`.
    pub fn threshold(&self, max_value: f64) -> f64 {
        let plain = self.certificate.threshold(self.rule.tolerance, max_value);
        let wanted = if self.strict { plain.min(self.sufficient(max_value)) } else { plain };
        wanted.max(self.certificate.floor(max_value))
    }

    /// Whether values with this check need no further sweeps: they prove the tolerance, or no residual would.
    pub(crate) fn is_final(&self, check: Check) -> bool {
        let Check { residual, max_value } = check;
        let floor = self.certificate.floor(max_value);
        self.is_proven(check) || residual <= floor || self.sufficient(max_value) <= floor && self.is_close(check)
    }

    /// Whether a smaller residual of values with this check would prove the tolerance.
    pub(crate) fn is_within_reach(&self, check: Check) -> bool {
        self.sufficient(check.max_value) > self.certificate.hidden(check.max_value) / EXHAUSTED
    }

    /// The smallest residual that is worth a try where [`LimitMonitor::is_within_reach`], for values up to `max_value`.
    pub(crate) fn least_aim(&self, max_value: f64) -> f64 {
        self.sufficient(max_value).max(self.certificate.hidden(max_value) / EXHAUSTED)
    }

    /// Asks for a residual that allows for rounding and storage, if values with this check would prove the tolerance
    /// without. Returns false if the present residual does so already.
    pub(crate) fn becomes_strict(&mut self, check: Check) -> bool {
        let before = self.strict;
        self.strict |= self.is_close(check);
        self.strict != before
    }

    /// Whether values with this check prove the tolerance.
    pub(crate) fn is_proven(&self, check: Check) -> bool {
        self.bounds(check).1 <= self.rule.tolerance
    }

    /// Whether values with this check would prove the tolerance but for rounding and storage.
    fn is_close(&self, check: Check) -> bool {
        check.residual < self.certificate.threshold(self.rule.tolerance, check.max_value)
    }

    /// The proven bounds on |TV - V| and |V - V*| for the values as they are stored.
    pub fn bounds(&self, check: Check) -> (f64, f64) {
        let stored = self.storage_error(check.max_value);
        let residual = check.residual + (1.0 + self.certificate.discount * (1.0 + self.certificate.excess)) * stored;
        (residual, self.certificate.error_bound(check.residual, check.max_value) + stored)
    }

    /// Reports progress, and returns a status if the callback or a limit ends the solve now.
    pub fn check(&mut self, progress: &Progress) -> Option<Status> {
        self.stop.check();
        if let Some(observer) = &mut self.observer
            && observer(progress).is_break()
        {
            return Some(Status::Interrupted);
        }
        if let Some(limit) = self.rule.time_limit {
            let now = Instant::now();
            // The longest: later passes may leave out states that the pass at the end does not.
            self.between = self.between.max(self.checked.replace(now).map_or(Duration::ZERO, |before| now - before));
            let (checks, besides) = self.to_end;
            // If the solve goes on, it ends after the next check at the earliest.
            if now - self.started + (checks + 1) * self.between + besides >= limit {
                return Some(Status::TimeLimit);
            }
        }
        (progress.sweeps >= self.rule.max_sweeps as f64).then_some(Status::IterationLimit)
    }

    /// Returns the status of a solve whose values have this exact check, or None if it has to go on. `stopped` is the
    /// status with which a limit ended it.
    pub fn conclude(&mut self, check: Check, stopped: Option<Status>) -> Option<Status> {
        if self.is_proven(check) {
            return Some(Status::Converged);
        }
        if stopped.is_some() {
            return stopped;
        }
        if self.is_final(check) || self.strict && check.residual < self.threshold(check.max_value) {
            return Some(Status::PrecisionLimit);
        }
        self.strict |= self.is_close(check);
        None
    }

    /// Seconds since the start.
    pub fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }
}
