//! Problems in explicit sparse rows.
//!
//! The rows are compressed. State `s` has the rows `action_offsets[s]..action_offsets[s + 1]`, one for each action, in
//! order. Row `r` has the entries `row_offsets[r]..row_offsets[r + 1]` of `successors` and `probabilities`, and the
//! stage cost `stage_costs[r]`. A state without rows is absorbing and has value 0.
//!
//! The constructor validates all arrays. They may be borrowed or owned, and they are not copied.

use std::borrow::Cow;

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::mdp::{Facts, Mdp, ROW_SUM_TOLERANCE};
use crate::stop::StopFlag;

/// Largest admissible |stage cost|. Sums of smaller costs do not overflow in any solver.
pub const LARGEST_STAGE_COST: f64 = 1e100;

/// A Markov decision process in compressed sparse rows.
#[derive(Debug, Clone, PartialEq)]
pub struct TabularMdp<'a> {
    action_offsets: Cow<'a, [usize]>,
    row_offsets: Cow<'a, [usize]>,
    successors: Cow<'a, [u32]>,
    probabilities: Cow<'a, [f64]>,
    stage_costs: Cow<'a, [f64]>,
    discount: f64,
    facts: Facts,
}

/// The arrays of a [`TabularMdp`], borrowed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parts<'a> {
    /// Rows of state s: `action_offsets[s] .. action_offsets[s + 1]`.
    pub action_offsets: &'a [usize],
    /// Entries of row r: `row_offsets[r] .. row_offsets[r + 1]`.
    pub row_offsets: &'a [usize],
    /// Successor of each entry.
    pub successors: &'a [u32],
    /// Probability of each entry.
    pub probabilities: &'a [f64],
    /// Stage cost of each row.
    pub stage_costs: &'a [f64],
}

impl<'a> TabularMdp<'a> {
    /// Takes `action_offsets [n + 1]`, `row_offsets [rows + 1]`, `successors [entries]`, `probabilities [entries]`,
    /// `stage_costs [rows]` (slices or vectors) and the discount in (0, 1], and validates them.
    ///
    /// # Errors
    /// [`Error::Length`] or [`Error::Parameter`] for an array as a whole. [`Error::Row`] names the first state and
    /// action that break a rule:
    ///
    /// * Offsets do not fall, and stay in range. Successors are states.
    /// * Probabilities lie in [0, 1], and those of a row sum to one within 1e-9.
    /// * Costs are at most 1e100 in size and, if the discount is 1, not negative.
    /// * If the discount is 1, steps of cost zero do not form a loop. A state in which the execution ends has no rows.
    ///
    /// # Examples
    /// State 0 has two actions, both of which lead to the absorbing state 1, at costs 5 and 3:
    ///
    /// ```
    /// use ppvi::{StopRule, TabularMdp, value_iteration};
    ///
    /// let mdp = TabularMdp::new(vec![0, 2, 2], vec![0, 1, 2], vec![1, 1], vec![1.0, 1.0], vec![5.0, 3.0], 1.0)?;
    /// let solution = value_iteration(&mdp, StopRule::new(1e-6)?, None)?;
    /// assert_eq!(solution.values, [3.0, 0.0]);
    /// assert_eq!(solution.policy, [1, 0]);
    /// # Ok::<(), ppvi::Error>(())
    /// ```
    pub fn new(
        action_offsets: impl Into<Cow<'a, [usize]>>,
        row_offsets: impl Into<Cow<'a, [usize]>>,
        successors: impl Into<Cow<'a, [u32]>>,
        probabilities: impl Into<Cow<'a, [f64]>>,
        stage_costs: impl Into<Cow<'a, [f64]>>,
        discount: f64,
    ) -> Result<Self> {
        let mut mdp = TabularMdp {
            action_offsets: action_offsets.into(),
            row_offsets: row_offsets.into(),
            successors: successors.into(),
            probabilities: probabilities.into(),
            stage_costs: stage_costs.into(),
            discount,
            facts: Facts::default(),
        };
        mdp.check_arrays()?;
        let states = (0..mdp.states()).into_par_iter().with_min_len(4096);
        // Of two errors the first one stays.
        let join = |a: Result<Facts>, b: Result<Facts>| Ok(a?.join(b?));
        let stop = StopFlag::current();
        let facts = |state| {
            stop.check();
            mdp.check_state(state)
        };
        mdp.facts = states.map(facts).reduce(|| Ok(Facts::default()), join)?;
        if discount == 1.0 && mdp.facts.least_stage_cost == 0.0 {
            mdp.add_potential()?;
        }
        Ok(mdp)
    }

    /// Expands any problem into explicit rows.
    ///
    /// If some row sums to less than one, an absorbing state is added at the end, to which the remaining probability
    /// leads. An absorbing state with a value other than 0 becomes a state with one action of that cost, which leads to
    /// the added state.
    ///
    /// # Errors
    /// The errors of [`TabularMdp::new`].
    pub fn from_mdp(mdp: &impl Mdp) -> Result<TabularMdp<'static>> {
        let states = mdp.states();
        let (mut action_offsets, mut row_offsets) = (vec![0], vec![0]);
        let (mut successors, mut probabilities, mut stage_costs) = (Vec::new(), Vec::new(), Vec::new());
        let mut has_end = false;
        let stop = StopFlag::current();
        for state in 0..states {
            stop.check();
            if mdp.actions(state) == 0 && mdp.absorbing_value(state) != 0.0 {
                // An absorbing state of this value: one action of this cost that ends the execution.
                successors.push(states as u32);
                probabilities.push(1.0);
                stage_costs.push(mdp.absorbing_value(state));
                row_offsets.push(successors.len());
                has_end = true;
            }
            for action in 0..mdp.actions(state) {
                let mut total = 0.0;
                mdp.for_each_successor(state, action, |next, probability| {
                    successors.push(next as u32);
                    probabilities.push(probability);
                    total += probability;
                });
                if total < 1.0 - ROW_SUM_TOLERANCE {
                    successors.push(states as u32);
                    probabilities.push(1.0 - total);
                    has_end = true;
                }
                stage_costs.push(mdp.stage_cost(state, action));
                row_offsets.push(successors.len());
            }
            action_offsets.push(stage_costs.len());
        }
        if has_end {
            action_offsets.push(stage_costs.len());
        }
        TabularMdp::new(action_offsets, row_offsets, successors, probabilities, stage_costs, mdp.discount())
    }

    /// The same rows with another discount.
    ///
    /// # Errors
    /// As [`TabularMdp::new`].
    pub fn with_discount(&self, discount: f64) -> Result<TabularMdp<'static>> {
        TabularMdp::new(
            self.action_offsets.to_vec(),
            self.row_offsets.to_vec(),
            self.successors.to_vec(),
            self.probabilities.to_vec(),
            self.stage_costs.to_vec(),
            discount,
        )
    }

    /// The problem in which every state has only the action that the policy chooses; its values are those of the policy.
    ///
    /// # Errors
    /// [`Error::Length`] for a policy of another length; [`Error::Row`] for an action that a state does not have.
    pub fn under_policy(&self, policy: &[u32]) -> Result<TabularMdp<'static>> {
        check_length("policy", self.states(), policy.len())?;
        let (mut action_offsets, mut row_offsets) = (vec![0], vec![0]);
        let (mut successors, mut probabilities, mut stage_costs) = (Vec::new(), Vec::new(), Vec::new());
        for (state, &action) in policy.iter().enumerate() {
            let rows = self.rows(state);
            if !rows.is_empty() {
                if action as usize >= rows.len() {
                    let what = "the policy must choose an action that is available";
                    return Err(Error::Row { state, action: action as usize, what, value: f64::from(action) });
                }
                let (next, chances, cost) = self.row(rows.start + action as usize);
                successors.extend_from_slice(next);
                probabilities.extend_from_slice(chances);
                stage_costs.push(cost);
                row_offsets.push(successors.len());
            }
            action_offsets.push(stage_costs.len());
        }
        TabularMdp::new(action_offsets, row_offsets, successors, probabilities, stage_costs, self.discount)
    }

    /// The arrays of the problem.
    pub fn parts(&self) -> Parts<'_> {
        Parts {
            action_offsets: &self.action_offsets,
            row_offsets: &self.row_offsets,
            successors: &self.successors,
            probabilities: &self.probabilities,
            stage_costs: &self.stage_costs,
        }
    }

    /// Indices of the rows of a state, one for each action.
    #[inline]
    pub fn rows(&self, state: usize) -> std::ops::Range<usize> {
        self.action_offsets[state]..self.action_offsets[state + 1]
    }

    /// Successors, probabilities and stage cost of a row.
    #[inline]
    pub fn row(&self, row: usize) -> (&[u32], &[f64], f64) {
        let entries = self.row_offsets[row]..self.row_offsets[row + 1];
        (&self.successors[entries.clone()], &self.probabilities[entries], self.stage_costs[row])
    }

    /// Number of rows plus number of entries.
    pub(crate) fn cells(&self) -> usize {
        self.successors.len() + self.stage_costs.len()
    }

    /// Successors, probabilities and costs of consecutive rows, and the offsets of the rows.
    #[inline]
    pub(crate) fn consecutive_rows(&self, rows: std::ops::Range<usize>) -> (&[u32], &[f64], &[f64], &[usize]) {
        let offsets = &self.row_offsets[rows.start..=rows.end];
        let entries = offsets[0]..offsets[rows.len()];
        (&self.successors[entries.clone()], &self.probabilities[entries], &self.stage_costs[rows], offsets)
    }

    fn check_arrays(&self) -> Result<()> {
        if !(self.discount > 0.0 && self.discount <= 1.0) {
            return Err(Error::parameter("discount", self.discount, "must be in (0, 1]"));
        }
        let rows = check_offsets("action_offsets", &self.action_offsets)?;
        if u32::try_from(self.action_offsets.len()).is_err() {
            return Err(Error::parameter("states", self.action_offsets.len() - 1, "must number less than 2^32"));
        }
        check_length("row_offsets", rows.saturating_add(1), self.row_offsets.len())?;
        check_length("stage_costs", rows, self.stage_costs.len())?;
        let entries = check_offsets("row_offsets", &self.row_offsets)?;
        check_length("successors", entries, self.successors.len())?;
        check_length("probabilities", entries, self.probabilities.len())
    }

    /// Checks the rows of one state. The lengths of the arrays and the ends of the offsets must have been checked.
    fn check_state(&self, state: usize) -> Result<Facts> {
        let mut facts = Facts::default();
        let (begin, end) = (self.action_offsets[state], self.action_offsets[state + 1]);
        let wrong = |action: usize, what, value: f64| Err(Error::Row { state, action, what, value });
        if begin > end || end > self.stage_costs.len() {
            return wrong(0, "action_offsets must not fall, nor pass the number of rows", end as f64);
        }
        for row in begin..end {
            let action = row - begin;
            let (first, last) = (self.row_offsets[row], self.row_offsets[row + 1]);
            if first > last || last > self.successors.len() {
                return wrong(action, "row_offsets must not fall, nor pass the number of entries", last as f64);
            }
            let (successors, probabilities, cost) = self.row(row);
            if let Some(&next) = successors.iter().find(|&&next| next as usize >= self.states()) {
                return wrong(action, "a successor must be less than the number of states", f64::from(next));
            }
            if let Some(&p) = probabilities.iter().find(|p| !(0.0..=1.0).contains(*p)) {
                return wrong(action, "a probability must be in [0, 1]", p);
            }
            let sum = probabilities.iter().fold(0.0, |sum, p| sum + p);
            if (sum - 1.0).abs() > ROW_SUM_TOLERANCE {
                return wrong(action, "the probabilities must sum to one", sum);
            }
            if !(-LARGEST_STAGE_COST..=LARGEST_STAGE_COST).contains(&cost) {
                return wrong(action, "the stage cost must be finite and at most 1e100 in size", cost);
            }
            if self.discount == 1.0 && cost < 0.0 {
                return wrong(action, "the stage cost must not be negative if the discount is 1", cost);
            }
            facts.add(successors.len(), sum, cost);
        }
        Ok(facts)
    }

    /// Raises the costs of steps of cost zero by a potential; see [`crate::termination`].
    ///
    /// # Errors
    /// [`Error::Row`] for an action of a loop of such steps.
    fn add_potential(&mut self) -> Result<()> {
        let positive = self.stage_costs.iter().copied().filter(|cost| *cost > 0.0).fold(f64::INFINITY, f64::min);
        let positive = if positive.is_finite() { positive } else { 1.0 };
        let levels = self.free_steps()? as f64 + 1.0;
        self.facts.least_stage_cost = positive / levels * (1.0 - 2.0 * ROW_SUM_TOLERANCE * levels);
        self.facts.potential = positive / levels * (levels - 1.0);
        Ok(())
    }

    /// The largest number of consecutive steps of cost zero, by depth-first search.
    fn free_steps(&self) -> Result<usize> {
        const NEW: usize = usize::MAX;
        const OPEN: usize = usize::MAX - 1;
        let mut ranks = vec![NEW; self.states()];
        // A state, its next entry, and the largest rank so far.
        let mut path: Vec<(usize, usize, usize)> = Vec::new();
        let first = |state: usize| self.row_offsets[self.rows(state).start];
        let end = |state: usize| self.row_offsets[self.rows(state).end];
        let stop = StopFlag::current();
        for root in 0..self.states() {
            stop.check();
            if ranks[root] == NEW {
                ranks[root] = OPEN;
                path.push((root, first(root), 0));
            }
            while let Some((state, entry, rank)) = path.pop() {
                stop.check();
                if entry == end(state) {
                    ranks[state] = rank;
                    if let Some(last) = path.last_mut() {
                        last.2 = last.2.max(rank + 1);
                    }
                    continue;
                }
                path.push((state, entry + 1, rank));
                let row = self.rows(state).start
                    + self.row_offsets[self.rows(state).start + 1..=self.rows(state).end]
                        .partition_point(|offset| *offset <= entry);
                if self.stage_costs[row] > 0.0 || self.probabilities[entry] == 0.0 {
                    continue;
                }
                let next = self.successors[entry] as usize;
                match ranks[next] {
                    OPEN => {
                        let action = row - self.rows(state).start;
                        let what = "steps of cost zero must not form a loop if the discount is 1; a state in which the \
                                    execution ends has no actions";
                        return Err(Error::Row { state, action, what, value: 0.0 });
                    }
                    NEW => {
                        ranks[next] = OPEN;
                        path.push((next, first(next), 0));
                    }
                    known => {
                        if let Some(last) = path.last_mut() {
                            last.2 = last.2.max(known + 1);
                        }
                    }
                }
            }
        }
        Ok(ranks.into_iter().max().unwrap_or(0))
    }
}

/// Checks that offsets begin with 0. Returns the last one.
fn check_offsets(name: &'static str, offsets: &[usize]) -> Result<usize> {
    match (offsets.first(), offsets.last()) {
        (Some(0), Some(&last)) => Ok(last),
        (Some(&first), _) => Err(Error::parameter(name, first, "must begin with 0")),
        _ => Err(Error::Length { name, expected: 1, found: 0 }),
    }
}

fn check_length(name: &'static str, expected: usize, found: usize) -> Result<()> {
    if expected == found { Ok(()) } else { Err(Error::Length { name, expected, found }) }
}

impl Mdp for TabularMdp<'_> {
    fn states(&self) -> usize {
        self.action_offsets.len() - 1
    }

    fn discount(&self) -> f64 {
        self.discount
    }

    #[inline]
    fn actions(&self, state: usize) -> usize {
        self.rows(state).len()
    }

    #[inline]
    fn stage_cost(&self, state: usize, action: usize) -> f64 {
        self.stage_costs[self.rows(state).start + action]
    }

    #[inline]
    fn for_each_successor(&self, state: usize, action: usize, mut visit: impl FnMut(usize, f64)) {
        let (successors, probabilities, _) = self.row(self.rows(state).start + action);
        for (&next, &probability) in successors.iter().zip(probabilities) {
            visit(next as usize, probability);
        }
    }

    fn facts(&self) -> Facts {
        self.facts
    }
}
