//! Rows that repeat, stored once.
//!
//! In a problem laid out on a grid the same thing happens in many places: the rows of two states differ by a shift of the
//! indices and by nothing else. Written relative to the state, as (successor - state, probability), they are equal. A
//! [`Block`] of consecutive states therefore keeps a dictionary of *patterns*, the whole set of actions of a state, and one
//! pattern number for every state. The dictionary is exact: a pattern is shared after comparing every bit of it. Where
//! nothing repeats it degenerates to a copy of the rows, and the search for repetitions is given up.
//!
//! Successors of probability zero and absorbing successors (value 0) contribute nothing and are left out, an action that
//! may enter a state of infinite value gets an infinite cost. A backup by patterns otherwise adds the same products in
//! the same order as [`TabularMdp`] does, so both give the same bits.
//!
//! *Direction.* Sweeping with rising index, a state whose successors all have lower indices finds them updated. Such
//! states belong to the forward list of their block, those with higher successors only to the backward list, and mixed
//! ones to both. A pair of sweeps, one each way, then visits little more than every state once, each of them at the right
//! time. Where nothing but the costs decides, a state has its final value from the start and is in neither list.

use std::collections::HashMap;
use std::ops::Range;

use crate::tabular::TabularMdp;

/// What a state is to others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Class {
    /// Its value is sought.
    Active,
    /// Value 0.
    Absorbing,
    /// Infinite value: the execution cannot be made to end.
    Endless,
}

/// One state of a forward or backward list.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Member {
    pub state: u32,
    pattern: u32,
}

/// Values that a backup reads.
pub(crate) trait Values {
    fn get(&self, state: usize) -> f64;
}

/// Which states a list reads.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Reads {
    /// Bit b: some member reads a state of block b.
    pub blocks: u128,
    /// Some member reads itself or a member that the list updates after it.
    pub late: bool,
}

/// Consecutive states with their dictionary.
#[derive(Debug, Default)]
pub(crate) struct Block {
    begin: usize,
    /// Pattern of every state; [`FIXED`] for states that have no value to find.
    patterns: Vec<u32>,
    /// Rows of a pattern: `row_offsets[pattern]..row_offsets[pattern + 1]`.
    row_offsets: Vec<u32>,
    costs: Vec<f64>,
    /// Entries of a row: `entry_offsets[row]..entry_offsets[row + 1]`.
    entry_offsets: Vec<u32>,
    /// Successor minus state, modulo 2^32.
    shifts: Vec<i32>,
    probabilities: Vec<f64>,
    /// First and last state with the pattern.
    spans: Vec<(u32, u32)>,
    /// The pattern that came after it last time: the first guess for the next state.
    followers: Vec<u32>,
    /// Members in rising and in falling order, and what they read.
    pub lists: [Vec<Member>; 2],
    pub reads: [Reads; 2],
}

const FIXED: u32 = u32::MAX;

impl Block {
    /// Compiles the states of a range; blocks hold `1 << shift` states each.
    pub fn new(mdp: &TabularMdp, classes: &[Class], range: Range<usize>, shift: u32) -> Self {
        let mut block = Block { begin: range.start, row_offsets: vec![0], entry_offsets: vec![0], ..Block::default() };
        block.patterns.reserve(range.len());
        let mut dictionary: HashMap<u64, u32> = HashMap::new();
        let mut previous = 0;
        for state in range.clone() {
            if classes[state] != Class::Active {
                block.patterns.push(FIXED);
                continue;
            }
            let guess = block.followers.get(previous as usize).copied();
            let pattern = match guess {
                Some(guess) if block.matches(guess, mdp, classes, state) => guess,
                _ => block.find_or_add(&mut dictionary, mdp, classes, state),
            };
            block.spans[pattern as usize].1 = state as u32;
            block.patterns.push(pattern);
            block.followers[previous as usize] = pattern;
            previous = pattern;
        }
        block.make_lists(range.start >> shift, shift);
        block
    }

    pub fn count(&self) -> usize {
        self.spans.len()
    }

    fn find_or_add(
        &mut self,
        dictionary: &mut HashMap<u64, u32>,
        mdp: &TabularMdp,
        classes: &[Class],
        state: usize,
    ) -> u32 {
        // Four thousand states tell whether patterns repeat.
        if self.patterns.len() >= 4096 && self.count() > self.patterns.len() / 2 {
            return self.add(mdp, classes, state);
        }
        let hash = hash(mdp, classes, state);
        match dictionary.get(&hash) {
            Some(&pattern) if self.matches(pattern, mdp, classes, state) => pattern,
            _ => {
                let pattern = self.add(mdp, classes, state);
                dictionary.insert(hash, pattern);
                pattern
            }
        }
    }

    fn add(&mut self, mdp: &TabularMdp, classes: &[Class], state: usize) -> u32 {
        for row in mdp.rows(state) {
            let (successors, probabilities, cost) = mdp.row(row);
            let mut cost = cost;
            for (&next, &probability) in successors.iter().zip(probabilities).filter(|entry| *entry.1 > 0.0) {
                match classes[next as usize] {
                    Class::Active => {
                        self.shifts.push(next.wrapping_sub(state as u32) as i32);
                        self.probabilities.push(probability);
                    }
                    Class::Endless => cost = f64::INFINITY,
                    Class::Absorbing => {}
                }
            }
            self.costs.push(cost);
            self.entry_offsets.push(self.shifts.len() as u32);
        }
        self.row_offsets.push(self.costs.len() as u32);
        self.spans.push((state as u32, state as u32));
        self.followers.push(0);
        self.count() as u32 - 1
    }

    /// Whether `state` has exactly this pattern.
    fn matches(&self, pattern: u32, mdp: &TabularMdp, classes: &[Class], state: usize) -> bool {
        let rows = self.rows(pattern);
        let own = mdp.rows(state);
        rows.len() == own.len() && rows.zip(own).all(|(row, own)| self.row_matches(row, mdp.row(own), classes, state))
    }

    fn row_matches(
        &self,
        row: usize,
        (successors, probabilities, cost): (&[u32], &[f64], f64),
        classes: &[Class],
        state: usize,
    ) -> bool {
        let mut entry = self.entry_offsets[row] as usize;
        let end = self.entry_offsets[row + 1] as usize;
        let mut own_cost = cost;
        for (&next, &probability) in successors.iter().zip(probabilities) {
            if probability == 0.0 {
                continue;
            }
            match classes[next as usize] {
                Class::Active => {
                    if entry == end
                        || self.shifts[entry] != next.wrapping_sub(state as u32) as i32
                        || self.probabilities[entry] != probability
                    {
                        return false;
                    }
                    entry += 1;
                }
                Class::Endless => own_cost = f64::INFINITY,
                Class::Absorbing => {}
            }
        }
        entry == end && self.costs[row] == own_cost
    }

    fn rows(&self, pattern: u32) -> Range<usize> {
        self.row_offsets[pattern as usize] as usize..self.row_offsets[pattern as usize + 1] as usize
    }

    fn shifts(&self, pattern: u32) -> &[i32] {
        let rows = self.rows(pattern);
        &self.shifts[self.entry_offsets[rows.start] as usize..self.entry_offsets[rows.end] as usize]
    }

    /// Sorts the states into the lists and finds what the lists read.
    fn make_lists(&mut self, own: usize, shift: u32) {
        let mut directions = vec![[false; 2]; self.count()];
        for (pattern, &(first, last)) in self.spans.iter().enumerate() {
            let shifts = self.shifts(pattern as u32);
            let (lower, higher) = (shifts.iter().any(|&d| d < 0), shifts.iter().any(|&d| d > 0));
            let direction = if lower == higher { [!shifts.is_empty(); 2] } else { [lower, higher] };
            directions[pattern] = direction;
            let mut reads = [Reads::default(); 2];
            for &d in shifts {
                let (from, to) =
                    ((i64::from(first) + i64::from(d)) >> shift, (i64::from(last) + i64::from(d)) >> shift);
                for block in from..=to {
                    reads[0].blocks |= 1 << block;
                }
                reads[0].late |= d >= 0 && from == own as i64;
                reads[1].late |= d <= 0 && to == own as i64;
            }
            reads[1].blocks = reads[0].blocks;
            for side in 0..2 {
                if direction[side] {
                    self.reads[side].blocks |= reads[side].blocks;
                    self.reads[side].late |= reads[side].late;
                }
            }
        }
        let members = self.patterns.iter().enumerate().filter(|(_, pattern)| **pattern != FIXED);
        for (index, &pattern) in members {
            for side in 0..2 {
                if directions[pattern as usize][side] {
                    self.lists[side].push(Member { state: (self.begin + index) as u32, pattern });
                }
            }
        }
        self.lists[1].reverse();
    }

    /// The backup of a state and the first action that attains it.
    #[inline]
    fn backup(&self, pattern: u32, state: u32, discount: f64, values: &impl Values) -> (f64, usize) {
        let rows = self.rows(pattern);
        let mut best = (f64::INFINITY, 0);
        for (action, row) in rows.enumerate() {
            let entries = self.entry_offsets[row] as usize..self.entry_offsets[row + 1] as usize;
            let mut expectation = 0.0;
            for (&shift, &probability) in self.shifts[entries.clone()].iter().zip(&self.probabilities[entries]) {
                expectation += probability * values.get(state.wrapping_add(shift as u32) as usize);
            }
            let q = self.costs[row] + discount * expectation;
            if q < best.0 {
                best = (q, action);
            }
        }
        best
    }

    /// The backup of a member of a list.
    #[inline]
    pub fn backup_member(&self, member: Member, discount: f64, values: &impl Values) -> f64 {
        self.backup(member.pattern, member.state, discount, values).0
    }

    /// Calls `visit(state, backup, action)` for all states that have a value to find, in index order.
    pub fn each_backup(&self, discount: f64, values: &impl Values, mut visit: impl FnMut(usize, f64, usize)) {
        for (index, &pattern) in self.patterns.iter().enumerate().filter(|(_, pattern)| **pattern != FIXED) {
            let (value, action) = self.backup(pattern, (self.begin + index) as u32, discount, values);
            visit(self.begin + index, value, action);
        }
    }
}

/// Mixes everything that tells patterns apart; equal patterns have equal hashes.
fn hash(mdp: &TabularMdp, classes: &[Class], state: usize) -> u64 {
    let mut hash = 0u64;
    let mut mix = |word: u64| hash = (hash.rotate_left(23) ^ word).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    for row in mdp.rows(state) {
        let (successors, probabilities, cost) = mdp.row(row);
        mix(cost.to_bits());
        for (&next, &probability) in successors.iter().zip(probabilities).filter(|entry| *entry.1 > 0.0) {
            if classes[next as usize] == Class::Active {
                mix(u64::from(next.wrapping_sub(state as u32)));
                mix(probability.to_bits());
            }
        }
    }
    hash
}
impl Block {
    pub fn begin(&self) -> usize {
        self.begin
    }
    pub fn constants(&self, discount: f64, values: &impl Values, mut visit: impl FnMut(usize, f64)) {
        for (index, &pattern) in self.patterns.iter().enumerate().filter(|(_, pattern)| **pattern != FIXED) {
            if self.shifts(pattern).is_empty() {
                visit(self.begin + index, self.backup(pattern, (self.begin + index) as u32, discount, values).0);
            }
        }
    }
}
