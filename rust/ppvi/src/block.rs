//! Blocks of consecutive states, each with a forward and a backward update list.
//!
//! In a sweep with rising index, all successors of a state have been updated before the state itself if their indices
//! are lower. The same holds for a sweep with falling index if the indices of all successors are higher. A block
//! therefore has two lists. States of the *forward* list have no successor with a higher index, and states of the
//! *backward* list have none with a lower index. Mixed states and states with a self-loop are in both lists. A state
//! whose successors are all absorbing gets its final value from one backup and is in neither list.
//!
//! One forward and one backward sweep together update most states once, with updated successors. The lists need no
//! knowledge of the geometry: on a lattice of headings they separate the headings that point left from those that point
//! right.

use std::ops::Range;

use crate::bellman::larger;
use crate::pattern::{Class, Dictionary, Source, Twin, Values};
use crate::stop::StopFlag;

/// Largest number of blocks: [`List::reads`] has one bit for each block.
pub(crate) const MOST_BLOCKS: usize = 128;

/// States of a block that one task updates, in this order.
#[derive(Debug, Default)]
pub(crate) struct List {
    members: Vec<Member>,
    /// How each member agrees with the one before it.
    twins: Vec<Twin>,
    /// Bit b is set if the update of some member may read a state of block b.
    pub reads: u128,
    /// Whether some member may read itself or a member that is updated after it.
    pub late: bool,
}

#[derive(Debug, Clone, Copy)]
struct Member {
    state: u32,
    /// Index in the dictionary of the first cell of its pattern.
    start: u32,
}

/// Values that one thread may write while others read them.
pub(crate) trait SharedValues: Values {
    fn set(&self, state: usize, value: f64);
}

/// A range of consecutive states, compiled to patterns and update lists.
#[derive(Debug)]
pub(crate) struct Block {
    begin: usize,
    /// Pattern of every state, or [`FIXED`].
    patterns: Vec<u32>,
    dictionary: Dictionary,
    /// The forward and the backward list.
    pub lists: [List; 2],
}

/// Entry of [`Block::patterns`] for a state that is not active.
const FIXED: u32 = u32::MAX;

impl Block {
    /// Compiles block number `number`. A block has `1 << log_size` states, and the last block may have fewer.
    pub fn new(source: Source, number: usize, log_size: u32, stop: &StopFlag) -> Self {
        let begin = number << log_size;
        let states = begin..source.classes.len().min((number + 1) << log_size);
        let mut dictionary = Dictionary::new();
        let mut spans: Vec<Range<i64>> = Vec::new();
        let mut patterns = Vec::with_capacity(states.len());
        for state in states {
            stop.check();
            if source.classes[state] != Class::Active {
                patterns.push(FIXED);
                continue;
            }
            let pattern = dictionary.pattern(source, state);
            match spans.get_mut(pattern as usize) {
                Some(span) => span.end = state as i64,
                None => spans.push(state as i64..state as i64),
            }
            patterns.push(pattern);
        }
        dictionary.finish();
        let mut block = Block { begin, patterns, dictionary, lists: Default::default() };
        let directions: Vec<[bool; 2]> =
            spans.iter().enumerate().map(|(pattern, span)| block.read(pattern as u32, span, log_size)).collect();
        block.fill_lists(&directions);
        block
    }

    /// Returns in which lists (forward, backward) the states of a pattern belong, and adds the blocks that they read to
    /// [`List::reads`] and [`List::late`]. `span` holds the first and the last state of the pattern.
    fn read(&mut self, pattern: u32, span: &Range<i64>, log_size: u32) -> [bool; 2] {
        let (mut lower, mut higher) = (false, false);
        self.dictionary.each_shift(pattern, |shift| {
            lower |= shift < 0;
            higher |= shift > 0;
        });
        let directions = if lower == higher { [!self.dictionary.is_constant(pattern); 2] } else { [lower, higher] };
        let own = (self.begin >> log_size) as i64;
        let lists = &mut self.lists;
        self.dictionary.each_shift(pattern, |shift| {
            let first = (span.start + i64::from(shift)) >> log_size;
            let last = (span.end + i64::from(shift)) >> log_size;
            // The first state reads the lowest index, the last state the highest, and all others between the two.
            let late = [shift >= 0 && first == own, shift <= 0 && last == own];
            for (side, list) in lists.iter_mut().enumerate().filter(|(side, _)| directions[*side]) {
                list.late |= late[side];
                (first..=last).for_each(|block| list.reads |= 1 << block);
            }
        });
        directions
    }

    fn fill_lists(&mut self, directions: &[[bool; 2]]) {
        for (side, list) in self.lists.iter_mut().enumerate() {
            let active = self.patterns.iter().enumerate().filter(|(_, pattern)| **pattern != FIXED);
            let members = active.filter(|(_, pattern)| directions[**pattern as usize][side]);
            let member =
                |(at, &pattern)| Member { state: (self.begin + at) as u32, start: self.dictionary.start(pattern) };
            list.members = members.map(member).collect();
        }
        self.lists[1].members.reverse();
        let twins = self.lists.each_ref().map(|list| self.twins(&list.members));
        for (list, twins) in self.lists.iter_mut().zip(twins) {
            list.twins = twins;
        }
    }

    /// [`List::twins`] of members.
    fn twins(&self, members: &[Member]) -> Vec<Twin> {
        let pattern = |member: &Member| self.patterns[member.state as usize - self.begin];
        // By pattern: what was found last, and for which pattern before it, at which distance.
        let mut known: Vec<(u32, i32, Twin)> = vec![(FIXED, 0, Twin::No); self.dictionary.count()];
        let mut twins = Vec::with_capacity(members.len());
        twins.extend(members.first().map(|_| Twin::No));
        for pair in members.windows(2) {
            let [earlier, later] = [pattern(&pair[0]), pattern(&pair[1])];
            let distance = pair[1].state.wrapping_sub(pair[0].state) as i32;
            let last = &mut known[later as usize];
            if (last.0, last.1) != (earlier, distance) {
                *last = (earlier, distance, self.dictionary.twin(earlier, later, distance));
            }
            twins.push(last.2);
        }
        twins
    }

    /// Number of states in a list.
    pub fn list_len(&self, side: usize) -> usize {
        self.lists[side].members.len()
    }

    /// Backs up the states of a list in place and in order. Returns the largest change.
    pub fn update(&self, side: usize, discount: f64, values: &impl SharedValues) -> f64 {
        let mut largest = 0.0f64;
        let mut expectations = [0.0; 2];
        let List { members, twins, .. } = &self.lists[side];
        for (member, twin) in members.iter().zip(twins) {
            let new = match twin {
                Twin::No => self.dictionary.backup(member.start, member.state, discount, values, &mut expectations).0,
                Twin::Same => self.dictionary.backup_of_twin(member.start, discount, expectations),
                Twin::Swapped => {
                    expectations.swap(0, 1);
                    self.dictionary.backup_of_twin(member.start, discount, expectations)
                }
            };
            largest = larger(largest, (new - values.get(member.state as usize)).abs());
            values.set(member.state as usize, new);
        }
        largest
    }

    /// Writes the final values of the states whose successors are all absorbing. Returns the number of these states.
    pub fn solve_constants(&self, discount: f64, values: &impl SharedValues) -> u64 {
        let mut count = 0;
        for (state, pattern) in self.active().filter(|&(_, pattern)| self.dictionary.is_constant(pattern)) {
            let start = self.dictionary.start(pattern);
            values.set(state, self.dictionary.backup(start, state as u32, discount, values, &mut [0.0; 2]).0);
            count += 1;
        }
        count
    }

    /// Calls `visit(state, backup, action)` for every active state.
    pub fn each_backup(&self, discount: f64, values: &impl Values, mut visit: impl FnMut(usize, f64, usize)) {
        for (state, pattern) in self.active() {
            let start = self.dictionary.start(pattern);
            let (value, action) = self.dictionary.backup(start, state as u32, discount, values, &mut [0.0; 2]);
            visit(state, value, action);
        }
    }

    fn active(&self) -> impl Iterator<Item = (usize, u32)> {
        let states = self.patterns.iter().enumerate().map(|(at, &pattern)| (self.begin + at, pattern));
        states.filter(|&(_, pattern)| pattern != FIXED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mdp::Mdp;
    use crate::tabular::TabularMdp;
    use crate::termination::StopRule;

    /// A row of places with two sides. An action keeps or changes the side at a price, then moves one place up or two down.
    /// With `decoys` every state has a third action that never pays.
    fn row_of_places(decoys: bool) -> TabularMdp<'static> {
        let places = 5000;
        let (mut actions, mut rows) = (vec![0], vec![0]);
        let (mut successors, mut probabilities, mut costs) = (Vec::new(), Vec::new(), Vec::new());
        for state in 0..2 * places {
            let (place, side) = (state / 2, state % 2);
            if place > 1 && place < places - 1 {
                for (to, price) in
                    [(side, 0.0), (1 - side, 0.5), (side, 100.0)].into_iter().take(if decoys { 3 } else { 2 })
                {
                    successors.extend([(2 * (place + 1) + to) as u32, (2 * (place - 2) + to) as u32]);
                    probabilities.extend([0.75, 0.25]);
                    costs.push(1.0 + price + 0.3 * to as f64 + (place % 7) as f64);
                    rows.push(successors.len());
                }
            }
            actions.push(costs.len());
        }
        TabularMdp::new(actions, rows, successors, probabilities, costs, 0.99).unwrap()
    }

    #[test]
    fn twins_have_the_bits_of_backups() {
        let [twins, plain] = [false, true].map(|decoys| {
            let mdp = row_of_places(decoys);
            let classes: Vec<Class> = (0..mdp.states())
                .map(|state| if mdp.rows(state).is_empty() { Class::Absorbing } else { Class::Active })
                .collect();
            let block = Block::new(Source { mdp: &mdp, classes: &classes }, 0, 14, &StopFlag::current());
            let found = block.lists.iter().flat_map(|list| &list.twins).filter(|twin| **twin == Twin::Swapped).count();
            (crate::tabular_sweep(&mdp, StopRule::new(1e-9).unwrap(), None).unwrap(), found)
        });
        assert!(twins.1 > 9000 && plain.1 == 0);
        assert_eq!(twins.0.values, plain.0.values);
        assert!(twins.0.values.iter().any(|value| *value > 100.0));
    }
}
