//! Stop rules, and the error bounds that a Bellman residual proves.
//!
//! Let B(s) = (TV)(s) - V(s) be the Bellman residual and e = max |B|.
//!
//! *Discount g < 1.* T is a contraction, so |V - V*| <= e / (1 - g). If e < (1 - g) * tolerance (the rule of section
//! 6.3 of the thesis), every value is correct to `tolerance`.
//!
//! *Discount 1, V >= 0, and stage costs of at least c > e (a stochastic shortest-path problem).* Scale V by 1 + h with
//! h >= e / (c - e):
//!
//! ```text
//! T((1 + h) V) <= (1 + h) TV - h c <= (1 + h) (V + e) - h c <= (1 + h) V
//! ```
//!
//! U >= TU implies U >= V*, hence V* <= (1 + h) V. In the same way V* >= (1 - h) V. Therefore |V - V*| <= V
//! e / (c - e). If e <= tolerance * c / (max V + tolerance), every value is correct to `tolerance`.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use crate::error::{Error, Result};
use crate::stop::StopFlag;

/// Largest threshold, as a part of the smallest stage cost c. A residual near c proves nothing, and the residual of
/// V = 0 is equal to c.
const MOST_OF_LEAST_COST: f64 = 0.5;

/// How a solve ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// The residual is below the threshold, so the error bound is at most the tolerance.
    Converged,
    /// The limit on sweeps was reached first. Solvers without sweeps count n backups as one sweep.
    IterationLimit,
    /// The time limit was reached first.
    TimeLimit,
    /// The residual is as small as rounding allows: the tolerance needs more than double precision.
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

/// Tolerance and limits of a solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopRule {
    /// Wanted bound on |V - V*|, in units of cost.
    pub tolerance: f64,
    /// Largest number of sweeps. Solvers without sweeps count n backups as one sweep.
    pub max_sweeps: u64,
    /// Wall-clock time by which the solve should end. No sweep is begun that would probably end later; the first sweep is
    /// made in any case.
    pub time_limit: Option<Duration>,
}

impl StopRule {
    /// Makes a rule with at most 100,000 sweeps and no time limit.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a tolerance that is not positive and finite.
    pub fn new(tolerance: f64) -> Result<Self> {
        let rule = StopRule { tolerance, max_sweeps: 100_000, time_limit: None };
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
    /// Largest change or residual of the last sweep, in units of cost.
    pub residual: f64,
    /// Residual below which the solve ends.
    pub threshold: f64,
}

/// Progress callback, called after every sweep, also after every inner sweep over a partition. `Break` stops the solve.
pub type Observer<'a> = &'a mut (dyn FnMut(&Progress) -> ControlFlow<()> + Send);

/// The numbers of a problem that determine its residual threshold and its error bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Certificate {
    /// Discount factor, in (0, 1].
    pub discount: f64,
    /// Smallest stage cost of the problem.
    pub least_stage_cost: f64,
}

impl Certificate {
    /// Returns the residual below which every value is correct to `tolerance`. If nothing can be proven (discount 1 and
    /// a stage cost that is not positive), returns `tolerance` itself.
    pub fn threshold(&self, tolerance: f64, max_value: f64) -> f64 {
        if self.discount < 1.0 {
            (1.0 - self.discount) * tolerance
        } else if self.least_stage_cost > 0.0 {
            let relative = tolerance / (max_value.max(0.0) + tolerance);
            self.least_stage_cost * relative.min(MOST_OF_LEAST_COST)
        } else {
            tolerance
        }
    }

    /// Returns the upper bound on max |V - V*| that the residual of V proves, or infinity if it proves nothing.
    /// `max_value` is the largest finite |V|.
    pub fn error_bound(&self, residual: f64, max_value: f64) -> f64 {
        if self.discount < 1.0 {
            residual / (1.0 - self.discount)
        } else if self.least_stage_cost > residual {
            max_value.max(0.0) * residual / (self.least_stage_cost - residual)
        } else {
            f64::INFINITY
        }
    }
}

/// Checks the limits of a [`StopRule`] during a solve, and reports progress.
pub struct LimitMonitor<'a> {
    rule: StopRule,
    started: Instant,
    /// Time of the last check.
    checked: Option<Instant>,
    /// Time from the last check at which a limit ends the solve to its end: in times between two checks, and besides.
    to_end: (u32, Duration),
    observer: Option<Observer<'a>>,
    stop: StopFlag,
}

impl<'a> LimitMonitor<'a> {
    /// Starts the clock.
    pub fn start(rule: StopRule, observer: Option<Observer<'a>>) -> Self {
        LimitMonitor {
            rule,
            started: Instant::now(),
            checked: None,
            to_end: (0, Duration::ZERO),
            observer,
            stop: StopFlag::current(),
        }
    }

    /// Tells how long the solver needs to its end after a limit is reached: `checks` times as long as from one check to
    /// the next, and `besides`.
    pub(crate) fn needs_to_end(&mut self, checks: u32, besides: Duration) {
        self.to_end = (checks, besides);
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
            let between = self.checked.replace(now).map_or(Duration::ZERO, |before| now - before);
            let (checks, besides) = self.to_end;
            // If the solve goes on, it ends after the next check at the earliest.
            if now - self.started + (checks + 1) * between + besides >= limit {
                return Some(Status::TimeLimit);
            }
        }
        (progress.sweeps >= self.rule.max_sweeps as f64).then_some(Status::IterationLimit)
    }

    /// Seconds since the start.
    pub fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }
}
