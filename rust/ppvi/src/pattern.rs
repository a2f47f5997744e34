//! Compression of rows that repeat: equal patterns are stored once.
//!
//! In a problem on a grid the actions of many states differ only by a shift of the indices. Relative to the state, as
//! pairs (successor - state, probability), their rows are equal. A [`Dictionary`] stores each such *pattern* once, so
//! one number describes a state, and a sweep reads a few bytes per state instead of about a hundred. The compression is
//! exact: two states share a pattern only if all its bits are equal. If the first few thousand states hardly repeat,
//! the search for repetitions ends, and the dictionary is a copy of the rows.
//!
//! Successors that are absorbing (value 0) or of probability zero contribute nothing to a backup and are left out. An
//! action that may enter an improper state gets an infinite cost. A backup then adds the same products in the same
//! order as a backup of [`TabularMdp`], so both give the same bits.

use std::collections::HashMap;
use std::ops::Range;

use crate::tabular::TabularMdp;

/// Class of a state, which decides how backups of other states read it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Class {
    /// The solver computes its value.
    Active,
    /// Its value is 0.
    Absorbing,
    /// Its value is infinite, because no policy ends the execution with probability one.
    Improper,
}

/// The problem, and the class of every state.
#[derive(Clone, Copy)]
pub(crate) struct Source<'s> {
    pub mdp: &'s TabularMdp<'s>,
    pub classes: &'s [Class],
}

impl Source<'_> {
    /// Returns the index of the successor minus that of the state. For a successor that is not active, returns a mark
    /// for its class instead: a number outside the range of index differences.
    #[inline]
    fn shift(&self, state: usize, next: u32) -> i32 {
        let class = self.classes[next as usize];
        if class == Class::Active { next.wrapping_sub(state as u32) as i32 } else { i32::MIN + class as i32 }
    }
}

/// Read access to the values of states.
pub(crate) trait Values {
    fn get(&self, state: usize) -> f64;
}

/// The patterns found so far, in compressed rows with marks for successors that are not active: for the comparison with
/// further states.
#[derive(Debug)]
struct Known {
    /// Rows of a pattern: `row_offsets[pattern]..row_offsets[pattern + 1]`.
    row_offsets: Vec<usize>,
    costs: Vec<f64>,
    /// Entries of a row: `entry_offsets[row]..entry_offsets[row + 1]`.
    entry_offsets: Vec<usize>,
    shifts: Vec<i32>,
    probabilities: Vec<f64>,
}

impl Known {
    fn new() -> Self {
        let (row_offsets, entry_offsets) = (vec![0], vec![0]);
        Known { row_offsets, costs: Vec::new(), entry_offsets, shifts: Vec::new(), probabilities: Vec::new() }
    }

    fn add(&mut self, source: Source, state: usize) {
        for row in source.mdp.rows(state) {
            let (successors, probabilities, cost) = source.mdp.row(row);
            self.shifts.extend(successors.iter().map(|&next| source.shift(state, next)));
            self.probabilities.extend_from_slice(probabilities);
            self.costs.push(cost);
            self.entry_offsets.push(self.shifts.len());
        }
        self.row_offsets.push(self.costs.len());
    }

    /// Whether `state` has exactly this pattern.
    fn matches(&self, pattern: u32, source: Source, state: usize) -> bool {
        let Some(&end) = self.row_offsets.get(pattern as usize + 1) else {
            return false;
        };
        let (known, own) = (self.row_offsets[pattern as usize]..end, source.mdp.rows(state));
        if known.len() != own.len() {
            return false;
        }
        let (successors, probabilities, costs, offsets) = source.mdp.consecutive_rows(own);
        let known_offsets = &self.entry_offsets[known.start..=known.end];
        let ends = |offsets: &[usize], row: usize| offsets[row] - offsets[0];
        if costs != &self.costs[known.clone()]
            || !(1..=costs.len()).all(|row| ends(offsets, row) == ends(known_offsets, row))
        {
            return false;
        }
        let entries = known_offsets[0]..known_offsets[costs.len()];
        let pairs = probabilities.iter().zip(&self.probabilities[entries.clone()]);
        if !pairs.fold(true, |same, (p, known)| same & (p == known)) {
            return false;
        }
        let pairs = successors.iter().zip(&self.shifts[entries]);
        pairs.fold(true, |same, (&next, &known)| same & (source.shift(state, next) == known))
    }
}

/// Patterns, numbered in the order in which they were found, and packed for backups.
///
/// Two parallel arrays hold the cells of all rows. A row begins with a head cell: its number is the stage cost, and its
/// shift is the count of entries. In the last row of a pattern the bits of this count are inverted, which makes it
/// negative. The cells of the entries follow. A backup reads both arrays from the same index on and needs no other.
#[derive(Debug)]
pub(crate) struct Dictionary {
    shifts: Vec<i32>,
    numbers: Vec<f64>,
    /// Index of the first cell of every pattern.
    starts: Vec<u32>,
    known: Known,
    by_hash: HashMap<u64, u32>,
    /// For every pattern, the two patterns that followed it most recently: the first guesses for the next state.
    followers: Vec<[u32; 2]>,
    previous: usize,
    looked_up: usize,
}

/// Whether the two actions of a state have the successors and probabilities of those of the state that is updated before it.
/// Such a state needs no expectations of its own. On a lattice of headings, they are the two bevels of a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Twin {
    No,
    /// In the same order.
    Same,
    /// The first action has those of the second, and the second those of the first.
    Swapped,
}

/// Number of states after which the search for repetitions may end: if more than half of them had a new pattern.
const TRIAL: usize = 4096;

impl Dictionary {
    pub fn new() -> Self {
        Dictionary {
            shifts: Vec::new(),
            numbers: Vec::new(),
            starts: Vec::new(),
            known: Known::new(),
            by_hash: HashMap::new(),
            followers: Vec::new(),
            previous: 0,
            looked_up: 0,
        }
    }

    /// Number of patterns.
    pub fn count(&self) -> usize {
        self.starts.len()
    }

    /// Index of the first cell of a pattern.
    pub fn start(&self, pattern: u32) -> u32 {
        self.starts[pattern as usize]
    }

    /// Returns the number of the pattern of an active state, which it adds if it is new. Fast if consecutive calls are
    /// for neighbouring states.
    pub fn pattern(&mut self, source: Source, state: usize) -> u32 {
        if self.looked_up >= TRIAL && self.starts.len() > self.looked_up / 2 {
            return self.add(source, state);
        }
        self.looked_up += 1;
        let guesses = self.followers.get(self.previous).copied().unwrap_or_default();
        let guess = guesses.into_iter().find(|&guess| self.known.matches(guess, source, state));
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
            && self.known.matches(pattern, source, state)
        {
            return pattern;
        }
        let pattern = self.add(source, state);
        self.known.add(source, state);
        self.followers.push([0; 2]);
        self.by_hash.insert(hash, pattern);
        pattern
    }

    fn add(&mut self, source: Source, state: usize) -> u32 {
        self.starts.push(self.shifts.len() as u32);
        let mut head = 0;
        for row in source.mdp.rows(state) {
            let (successors, probabilities, cost) = source.mdp.row(row);
            head = self.shifts.len();
            self.push(0, cost);
            for (&next, &probability) in successors.iter().zip(probabilities).filter(|entry| *entry.1 > 0.0) {
                match source.classes[next as usize] {
                    Class::Active => self.push(source.shift(state, next), probability),
                    Class::Improper => self.numbers[head] = f64::INFINITY,
                    Class::Absorbing => {}
                }
            }
            self.shifts[head] = (self.shifts.len() - head - 1) as i32;
        }
        self.shifts[head] = !self.shifts[head];
        self.starts.len() as u32 - 1
    }

    fn push(&mut self, shift: i32, number: f64) {
        self.shifts.push(shift);
        self.numbers.push(number);
    }

    /// Calls `visit` for every successor of every action of a pattern, as index difference to the state.
    pub fn each_shift(&self, pattern: u32, mut visit: impl FnMut(i32)) {
        let (mut cell, mut last) = (self.start(pattern) as usize, false);
        while !last {
            let entries;
            (entries, last) = self.entries(cell);
            self.shifts[entries.clone()].iter().for_each(|&shift| visit(shift));
            cell = entries.end;
        }
    }

    /// Whether every successor is absorbing, so that a backup depends on costs only.
    pub fn is_constant(&self, pattern: u32) -> bool {
        let mut constant = true;
        self.each_shift(pattern, |_| constant = false);
        constant
    }

    /// Cells of the entries of the row that begins at `cell`, and whether this row is the last of its pattern.
    #[inline]
    fn entries(&self, cell: usize) -> (Range<usize>, bool) {
        let head = self.shifts[cell];
        let last = head < 0;
        (cell + 1..cell + 1 + if last { !head } else { head } as usize, last)
    }

    /// One Bellman backup of a state whose pattern begins at cell `start`: returns the smallest Q-value and the first
    /// action that attains it. Notes the expectations of the first two actions for a [`Twin`].
    #[inline]
    pub fn backup(
        &self,
        start: u32,
        state: u32,
        discount: f64,
        values: &impl Values,
        expectations: &mut [f64; 2],
    ) -> (f64, usize) {
        let mut best = (f64::INFINITY, 0);
        let (mut cell, mut action) = (start as usize, 0);
        loop {
            let (entries, last) = self.entries(cell);
            let (shifts, probabilities) = (&self.shifts[entries.clone()], &self.numbers[entries.clone()]);
            let mut expectation = 0.0;
            for (&shift, &probability) in shifts.iter().zip(probabilities) {
                expectation += probability * values.get(state.wrapping_add_signed(shift) as usize);
            }
            if let Some(noted) = expectations.get_mut(action) {
                *noted = expectation;
            }
            let q = self.numbers[cell] + discount * expectation;
            if q < best.0 {
                best = (q, action);
            }
            if last {
                return best;
            }
            cell = entries.end;
            action += 1;
        }
    }

    /// The smallest Q-value of a state with two actions, from their expectations.
    #[inline]
    pub fn backup_of_twin(&self, start: u32, discount: f64, expectations: [f64; 2]) -> f64 {
        let first = start as usize;
        let second = self.entries(first).0.end;
        let [a, b] = [(first, expectations[0]), (second, expectations[1])]
            .map(|(cell, expectation)| self.numbers[cell] + discount * expectation);
        // As in a backup, where the first action wins a tie.
        if b < a { b } else { a }
    }

    /// How the rows of a state with the pattern `later` agree with those of a state with the pattern `earlier`, whose index is
    /// smaller by `distance`.
    pub fn twin(&self, earlier: u32, later: u32, distance: i32) -> Twin {
        let (Some(before), Some(after)) = (self.two_rows(earlier), self.two_rows(later)) else { return Twin::No };
        let agree = |one: &Range<usize>, other: &Range<usize>| {
            let shifts = self.shifts[one.clone()].iter().zip(&self.shifts[other.clone()]);
            one.len() == other.len()
                && self.numbers[one.clone()] == self.numbers[other.clone()]
                // Not the earlier state itself: its value changes in between.
                && shifts.fold(true, |same, (a, b)| same & (*a != 0) & (a.wrapping_sub(distance) == *b))
        };
        match () {
            () if agree(&before[0], &after[1]) && agree(&before[1], &after[0]) => Twin::Swapped,
            () if agree(&before[0], &after[0]) && agree(&before[1], &after[1]) => Twin::Same,
            () => Twin::No,
        }
    }

    /// The cells of the entries of the rows of a pattern with two rows.
    fn two_rows(&self, pattern: u32) -> Option<[Range<usize>; 2]> {
        let (first, is_last) = self.entries(self.start(pattern) as usize);
        if is_last {
            return None;
        }
        let (second, is_last) = self.entries(first.end);
        is_last.then_some([first, second])
    }

    /// Frees the memory that only the search for repetitions needs.
    pub fn finish(&mut self) {
        self.known = Known::new();
        self.by_hash = HashMap::new();
        self.followers = Vec::new();
    }
}

/// Hash of the pattern of a state. Equal patterns have equal hashes.
fn hash(source: Source, state: usize) -> u64 {
    let mut hash = 0u64;
    let mut mix = |word: u64| hash = (hash.rotate_left(23) ^ word).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let (successors, probabilities, costs, _) = source.mdp.consecutive_rows(source.mdp.rows(state));
    successors.iter().for_each(|&next| mix(source.shift(state, next) as u64));
    probabilities.iter().chain(costs).for_each(|number| mix(number.to_bits()));
    hash
}
