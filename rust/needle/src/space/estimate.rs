//! Success of the policy from a pose: executions, with the table as a control variate.
//!
//! Let V be the stored success at the end of a step (1 in the target, 0 after a failure), and s_0, s_1, ... s_T the ends of the
//! steps of an execution. At every step, other ends s'_t with the same action and noise of their own are drawn, m of them:
//!
//! ```text
//! Z = [reached] - sum over t of ( V(s_t) - mean V(s'_t) )
//! ```
//!
//! Given what came before, s_t and s'_t have the same distribution. So the sum has the mean zero, and Z that of
//! `[reached]`, **whatever the table says**: it cannot make the estimate wrong. The better the table, the less Z varies: if it
//! is exact, the variance is that of `[reached]`, divided by m. The decision of a step takes far more time than an end of it.
//! (Henderson and Glynn, Approximating martingales for variance reduction in Markov process simulation, 2002.)

use ppvi::{Result, StopFlag};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;

use crate::random::stream;
use crate::space::arc::SpacePose;
use crate::space::execution::{SpaceExecutor, StepEnd};
use crate::workspace::Event;

/// Further ends that are drawn at each step.
const ENDS: u32 = 8;

/// Makes the random numbers different from those of rollouts, whatever their seed.
const SALT: u64 = 0x7472_7574_685f_7661;

impl SpaceExecutor<'_> {
    /// Independent numbers whose mean is the probability that the policy reaches the target from a pose. A number may lie outside
    /// of [0, 1]. No number depends on the number of threads.
    ///
    /// # Errors
    /// As [`SpaceExecutor::rollout`].
    pub fn estimate(&self, start: SpacePose, runs: usize, seed: u64) -> Result<Vec<f64>> {
        let start = self.checked(start)?;
        let stop = StopFlag::current();
        // All executions begin with the same decision.
        let first = self.event_at(&start).ok_or_else(|| self.best_action(start).0);
        let one = |run| {
            stop.check();
            match first {
                Ok(event) => f64::from(u8::from(event == Event::Target)),
                Err(action) => self.controlled(start, action, &mut stream(seed ^ SALT, run as u64)),
            }
        };
        Ok((0..runs).into_par_iter().with_min_len(16).map(one).collect())
    }

    /// One execution that begins with an action: its outcome less the sum of the differences.
    fn controlled(&self, mut pose: SpacePose, mut action: usize, random: &mut Xoshiro256PlusPlus) -> f64 {
        let mut sum = 0.0;
        loop {
            let course = self.course(pose, action);
            let mut others = 0.0;
            for _ in 0..ENDS {
                others += self.success_at(&self.disturbed_step(course, random));
            }
            sum += others / f64::from(ENDS);
            let end = self.disturbed_step(course, random);
            if end.event.or_else(|| self.event_at(&end.pose)).is_some() {
                // The outcome is what the last end counts: they cancel.
                return sum;
            }
            sum -= self.stored_success(end.pose).0;
            pose = end.pose;
            action = self.best_action(pose).0;
        }
    }

    /// Success at the end of a step: its outcome, or what the table says.
    fn success_at(&self, end: &StepEnd) -> f64 {
        match end.event.or_else(|| self.event_at(&end.pose)) {
            Some(event) => f64::from(u8::from(event == Event::Target)),
            None => self.stored_success(end.pose).0,
        }
    }
}
