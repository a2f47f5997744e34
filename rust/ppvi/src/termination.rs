//! When a solver stops, and what it may then claim.
//!
//! Let B(s) = (TV)(s) - V(s) be the Bellman residual and e = max |B|.
//!
//! *Discount g < 1.* T is a contraction, so |V - V*| <= e / (1 - g). Stopping at e < (1 - g) * tolerance (the rule of
//! the thesis, section 6.3) makes every value correct to `tolerance`.
//!
//! *Discount 1, stage costs >= c > e (a stochastic shortest-path problem), V >= 0.* Scale V: since
//! T((1 + h)V) <= (1 + h) TV - h c <= (1 + h)(V + e) - h c <= (1 + h) V as soon as h >= e / (c - e), and U >= TU
//! implies U >= V*, we get V* <= (1 + h) V; in the same way V* >= (1 - h) V. Hence |V - V*| <= V e / (c - e), and
//! e <= tolerance * c / (max V + tolerance) makes every value correct to `tolerance`.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use crate::error::{Error, Result};

/// A residual near the least stage cost proves nothing, and all values zero have just that residual.
const MOST_OF_LEAST_COST: f64 = 0.5;

/// How a solve ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// The residual is below the threshold: the error bound holds and is at most the tolerance.
    Converged,
    /// The limit on sweeps (or on backups, counted in sweeps of n) was reached first.
    IterationLimit,
    /// The time limit was reached first.
    TimeLimit,
    /// Rounding hides what is left of the residual: the tolerance asks for more than double precision.
    PrecisionLimit,
    /// The progress callback asked to stop.
    Interrupted,
}

impl Status {
    /// The name used in files and in Python.
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

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopRule {
    /// Wanted bound on |V - V*|, in units of cost.
    pub tolerance: f64,
    /// Limit on the number of sweeps; solvers that do not sweep count n backups as one.
    pub max_sweeps: u64,
    /// Limit on the wall-clock time.
    pub time_limit: Option<Duration>,
}

impl StopRule {
    /// A rule with no time limit and 100,000 sweeps.
    pub fn new(tolerance: f64) -> Result<Self> {
        let rule = StopRule { tolerance, max_sweeps: 100_000, time_limit: None };
        rule.validate()?;
        Ok(rule)
    }

    /// Checks the fields, which are public.
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

/// What the progress callback is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Sweeps done, in units of n backups.
    pub sweeps: f64,
    /// Largest change or residual seen in the last sweep, in units of cost.
    pub residual: f64,
    /// The residual that ends the solve.
    pub threshold: f64,
}

/// Called once a sweep, or once a partition where partitions are processed one by one; `Break` stops the solve.
pub type Observer<'a> = &'a mut (dyn FnMut(&Progress) -> ControlFlow<()> + Send);

/// The facts about a problem that decide its threshold and its error bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Certificate {
    /// Discount factor, in (0, 1].
    pub discount: f64,
    /// Smallest stage cost of the problem.
    pub least_stage_cost: f64,
}

impl Certificate {
    /// The residual below which every value is correct to `tolerance`; where nothing can be proven (discount 1 and a
    /// stage cost that is not positive) it is `tolerance` itself.
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

    /// A proven bound on max |V - V*|, from the residual of V; infinite where nothing is proven.
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

/// Watches the limits of a [`StopRule`] during a solve.
pub struct LimitMonitor<'a> {
    rule: StopRule,
    started: Instant,
    observer: Option<Observer<'a>>,
}

impl<'a> LimitMonitor<'a> {
    /// Starts the clock.
    pub fn start(rule: StopRule, observer: Option<Observer<'a>>) -> Self {
        LimitMonitor { rule, started: Instant::now(), observer }
    }

    /// Reports progress, then says whether a limit ends the solve now.
    pub fn check(&mut self, progress: &Progress) -> Option<Status> {
        if let Some(observer) = &mut self.observer
            && observer(progress).is_break()
        {
            return Some(Status::Interrupted);
        }
        if self.rule.time_limit.is_some_and(|limit| self.started.elapsed() >= limit) {
            return Some(Status::TimeLimit);
        }
        (progress.sweeps >= self.rule.max_sweeps as f64).then_some(Status::IterationLimit)
    }

    /// Seconds since the start.
    pub fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }
}
