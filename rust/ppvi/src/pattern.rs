//! Rows that repeat, stored once.
//!
//! In a problem laid out on a grid the same thing happens in many places: the actions of two states differ by a shift of
//! the indices and by nothing else. Written relative to the state, as (successor - state, probability), they are equal.
//! A [`Dictionary`] keeps every such *pattern* once, so that one number describes a state, and a sweep reads a few bytes a
//! state instead of a hundred. It is exact: a pattern is shared only after every bit of it has been compared. Where
//! nothing repeats it degenerates to a copy of the rows, and the search for repetitions is given up.
//!
//! Absorbing successors (value 0) and those of probability zero contribute nothing and are left out of the rows that
//! backups use; an action that may enter a state of infinite value gets an infinite cost. A backup then adds the same
//! products in the same order as [`TabularMdp`] does, so both give the same bits.

use std::collections::HashMap;
use std::ops::Range;

use crate::tabular::TabularMdp;

/// What a state is to those that read it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Class {
    /// Its value is sought.
    Active,
    /// Value 0.
    Absorbing,
    /// Infinite value: the execution cannot be made to end.
    Endless,
}

/// The problem, and the class of every state.
#[derive(Clone, Copy)]
pub(crate) struct Source<'s> {
    pub mdp: &'s TabularMdp<'s>,
    pub classes: &'s [Class],
}

impl Source<'_> {
    /// The successor relative to the state, or a mark (no index reaches that far) if it is not active.
    #[inline]
    fn shift(&self, state: usize, next: u32) -> i32 {
        let class = self.classes[next as usize];
        if class == Class::Active { next.wrapping_sub(state as u32) as i32 } else { i32::MIN + class as i32 }
    }
}

/// Values that a backup reads.
pub(crate) trait Values {
    fn get(&self, state: usize) -> f64;
}

/// Actions of many patterns in compressed rows, successors relative to the state.
#[derive(Debug)]
struct Rows {
    /// Rows of a pattern: `row_offsets[pattern]..row_offsets[pattern + 1]`.
    row_offsets: Vec<usize>,
    costs: Vec<f64>,
    /// Entries of a row: `entry_offsets[row]..entry_offsets[row + 1]`.
    entry_offsets: Vec<usize>,
    shifts: Vec<i32>,
    probabilities: Vec<f64>,
}

impl Rows {
    fn new() -> Self {
        let (row_offsets, entry_offsets) = (vec![0], vec![0]);
        Rows { row_offsets, costs: Vec::new(), entry_offsets, shifts: Vec::new(), probabilities: Vec::new() }
    }

    #[inline]
    fn of(&self, pattern: u32) -> Range<usize> {
        self.row_offsets[pattern as usize]..self.row_offsets[pattern as usize + 1]
    }

    fn push_entry(&mut self, shift: i32, probability: f64) {
        self.shifts.push(shift);
        self.probabilities.push(probability);
    }

    fn end_row(&mut self, cost: f64) {
        self.costs.push(cost);
        self.entry_offsets.push(self.shifts.len());
    }

    fn end_pattern(&mut self) {
        self.row_offsets.push(self.costs.len());
    }
}

/// Patterns, numbered as they were found.
#[derive(Debug)]
pub(crate) struct Dictionary {
    /// What backups use.
    rows: Rows,
    /// What states are compared with: everything, inactive successors as marks.
    raw: Rows,
    by_hash: HashMap<u64, u32>,
    /// The two patterns that came after a pattern last: the first guesses for the next state.
    followers: Vec<[u32; 2]>,
    previous: usize,
    looked_up: usize,
}

/// After so many states it is clear whether patterns repeat.
const TRIAL: usize = 4096;

impl Dictionary {
    pub fn new() -> Self {
        let (rows, raw) = (Rows::new(), Rows::new());
        Dictionary { rows, raw, by_hash: HashMap::new(), followers: Vec::new(), previous: 0, looked_up: 0 }
    }

    /// Number of patterns.
    pub fn len(&self) -> usize {
        self.rows.row_offsets.len() - 1
    }

    /// The number of the pattern of an active state; expects the states of a neighbourhood in order.
    pub fn pattern(&mut self, source: Source, state: usize) -> u32 {
        if self.looked_up >= TRIAL && self.len() > self.looked_up / 2 {
            self.raw = Rows::new();
            self.add(source, state);
            return self.len() as u32 - 1;
        }
        self.looked_up += 1;
        let guesses = self.followers.get(self.previous).copied().unwrap_or_default();
        let guess = guesses.into_iter().find(|&guess| self.matches(guess, source, state));
        let pattern = guess.unwrap_or_else(|| self.look_up(source, state));
        if pattern != guesses[0] {
            self.followers[self.previous] = [pattern, guesses[0]];
        }
        self.previous = pattern as usize;
        pattern
    }

    fn look_up(&mut self, source: Source, state: usize) -> u32 {
        let hash = hash(source, state);
        if let Some(&pattern) = self.by_hash.get(&hash)
            && self.matches(pattern, source, state)
        {
            return pattern;
        }
        let pattern = self.len() as u32;
        self.add(source, state);
        self.add_raw(source, state);
        self.followers.push([0; 2]);
        self.by_hash.insert(hash, pattern);
        pattern
    }

    fn add(&mut self, source: Source, state: usize) {
        for row in source.mdp.rows(state) {
            let (successors, probabilities, mut cost) = source.mdp.row(row);
            for (&next, &probability) in successors.iter().zip(probabilities).filter(|entry| *entry.1 > 0.0) {
                match source.classes[next as usize] {
                    Class::Active => self.rows.push_entry(source.shift(state, next), probability),
                    Class::Endless => cost = f64::INFINITY,
                    Class::Absorbing => {}
                }
            }
            self.rows.end_row(cost);
        }
        self.rows.end_pattern();
    }

    fn add_raw(&mut self, source: Source, state: usize) {
        for row in source.mdp.rows(state) {
            let (successors, probabilities, cost) = source.mdp.row(row);
            for (&next, &probability) in successors.iter().zip(probabilities) {
                self.raw.push_entry(source.shift(state, next), probability);
            }
            self.raw.end_row(cost);
        }
        self.raw.end_pattern();
    }

    /// Whether `state` has exactly this pattern.
    fn matches(&self, pattern: u32, source: Source, state: usize) -> bool {
        if pattern as usize >= self.len() {
            return false;
        }
        let (known, own) = (self.raw.of(pattern), source.mdp.rows(state));
        if known.len() != own.len() {
            return false;
        }
        let (successors, probabilities, costs, offsets) = source.mdp.consecutive_rows(own);
        let known_offsets = &self.raw.entry_offsets[known.start..=known.end];
        let ends = |offsets: &[usize], row: usize| offsets[row] - offsets[0];
        if costs != &self.raw.costs[known.clone()]
            || !(1..=costs.len()).all(|row| ends(offsets, row) == ends(known_offsets, row))
        {
            return false;
        }
        let entries = known_offsets[0]..known_offsets[costs.len()];
        let pairs = probabilities.iter().zip(&self.raw.probabilities[entries.clone()]);
        if !pairs.fold(true, |same, (p, known)| same & (p == known)) {
            return false;
        }
        let pairs = successors.iter().zip(&self.raw.shifts[entries]);
        pairs.fold(true, |same, (&next, &known)| same & (source.shift(state, next) == known))
    }

    /// Successors, of all actions of a pattern, relative to the state.
    pub fn shifts(&self, pattern: u32) -> &[i32] {
        let rows = self.rows.of(pattern);
        &self.rows.shifts[self.rows.entry_offsets[rows.start]..self.rows.entry_offsets[rows.end]]
    }

    /// The backup of a state that has the pattern, and the first action that attains it.
    #[inline]
    pub fn backup(&self, pattern: u32, state: u32, discount: f64, values: &impl Values) -> (f64, usize) {
        let rows = self.rows.of(pattern);
        let mut best = (f64::INFINITY, 0);
        for (action, row) in rows.enumerate() {
            let entries = self.rows.entry_offsets[row]..self.rows.entry_offsets[row + 1];
            let (shifts, probabilities) = (&self.rows.shifts[entries.clone()], &self.rows.probabilities[entries]);
            let mut expectation = 0.0;
            for (&shift, &probability) in shifts.iter().zip(probabilities) {
                expectation += probability * values.get(state.wrapping_add_signed(shift) as usize);
            }
            let q = self.rows.costs[row] + discount * expectation;
            if q < best.0 {
                best = (q, action);
            }
        }
        best
    }

    /// Releases what only the search for repetitions needs.
    pub fn finish(&mut self) {
        self.raw = Rows::new();
        self.by_hash = HashMap::new();
        self.followers = Vec::new();
    }
}

/// Equal patterns have equal hashes.
fn hash(source: Source, state: usize) -> u64 {
    let mut hash = 0u64;
    let mut mix = |word: u64| hash = (hash.rotate_left(23) ^ word).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let (successors, probabilities, costs, _) = source.mdp.consecutive_rows(source.mdp.rows(state));
    successors.iter().for_each(|&next| mix(source.shift(state, next) as u64));
    probabilities.iter().chain(costs).for_each(|number| mix(number.to_bits()));
    hash
}
