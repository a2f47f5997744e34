//! Ending long work from another thread.
//!
//! [`StopFlag::guard`] runs work under a flag, as `ThreadPool::install` of rayon runs it on a pool. Every long loop of
//! this crate checks the flag of its work about every millisecond. Once the flag is raised, the work is abandoned, and
//! `guard` returns [`Error::Stopped`]. There is no partial result; an [`Observer`](crate::Observer) ends a solve with
//! one. Without a guard the checks do nothing.
//!
//! The work is abandoned by unwinding its stack, like a panic but without its message. So nothing is stopped in a
//! program that is compiled with `panic = "abort"`: there the flag must not be raised.

use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::error::{Error, Result};

thread_local! {
    /// The flag of the innermost guard on this thread.
    static CURRENT: RefCell<StopFlag> = const { RefCell::new(StopFlag { raised: None }) };
}

/// What unwinds from the check of a raised flag.
struct Stopped;

/// A flag that ends long work. Clones share the flag.
///
/// # Examples
/// ```
/// use ppvi::{Error, StopFlag, StopRule, TabularMdp, value_iteration};
///
/// let mdp = TabularMdp::new(vec![0, 1], vec![0, 1], vec![0], vec![1.0], vec![2.0], 0.5)?;
/// let stop = StopFlag::new();
/// let solution = stop.guard(|| value_iteration(&mdp, StopRule::new(1e-9)?, None))??;
/// assert!((solution.values[0] - 4.0).abs() <= 1e-9);
///
/// stop.raise(); // on any thread, at any time
/// assert_eq!(stop.guard(|| value_iteration(&mdp, StopRule::new(1e-9)?, None)), Err(Error::Stopped));
/// # Ok::<(), Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct StopFlag {
    /// None for the flag of work without a guard, which nobody can raise.
    raised: Option<Arc<AtomicBool>>,
}

impl Default for StopFlag {
    fn default() -> Self {
        StopFlag { raised: Some(Arc::default()) }
    }
}

impl StopFlag {
    /// Makes a flag that is not raised.
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks the work under this flag to end. A raised flag stays raised.
    pub fn raise(&self) {
        if let Some(raised) = &self.raised {
            raised.store(true, Ordering::Relaxed);
        }
    }

    /// Whether the flag is raised.
    #[inline]
    pub fn is_raised(&self) -> bool {
        self.raised.as_ref().is_some_and(|raised| raised.load(Ordering::Relaxed))
    }

    /// Calls `work` under this flag.
    ///
    /// # Errors
    /// [`Error::Stopped`] if the flag is raised before the work is done.
    pub fn guard<R>(&self, work: impl FnOnce() -> R) -> Result<R> {
        let outer = CURRENT.replace(self.clone());
        let result = catch_unwind(AssertUnwindSafe(|| {
            self.check();
            work()
        }));
        CURRENT.set(outer);
        match result {
            Ok(result) => Ok(result),
            Err(payload) if payload.is::<Stopped>() => Err(Error::Stopped),
            Err(payload) => resume_unwind(payload),
        }
    }

    /// The flag of the work that this thread does. Threads that help it do not know it: ask before parallel loops.
    pub fn current() -> Self {
        CURRENT.with_borrow(Self::clone)
    }

    /// Abandons the work under this flag if it is raised. It must be a flag from [`StopFlag::current`]. The check takes
    /// about a nanosecond.
    #[inline]
    pub fn check(&self) {
        if self.is_raised() {
            resume_unwind(Box::new(Stopped));
        }
    }
}

#[cfg(test)]
mod tests {
    use rayon::prelude::*;

    use super::*;

    #[test]
    fn a_raised_flag_ends_parallel_loops_of_its_guard_only() {
        let (stop, other) = (StopFlag::new(), StopFlag::new());
        let work = |raise: bool| {
            let current = StopFlag::current();
            (0..100_000).into_par_iter().for_each(|index| {
                if raise && index == 50_000 {
                    stop.raise();
                }
                current.check();
            });
        };
        assert_eq!(stop.guard(|| work(true)), Err(Error::Stopped));
        assert_eq!(other.guard(|| work(true)), Ok(()));
        assert_eq!(stop.guard(|| other.guard(|| work(false))), Err(Error::Stopped));
        work(true);
    }

    #[test]
    fn a_panic_is_not_taken_for_a_stop() {
        let caught = catch_unwind(|| StopFlag::new().guard(|| resume_unwind(Box::new("a panic"))));
        assert_eq!(caught.unwrap_err().downcast_ref(), Some(&"a panic"));
        assert!(!StopFlag::current().is_raised());
    }
}
