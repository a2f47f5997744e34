//! Where the steps of a row end, as runs of states with one outcome.
//!
//! Obstacles, border and target are connected, so along a row of grid points the outcomes change only a few times. A
//! sweep computes every step as if it went on, and then overwrites the runs: far less work than a look at every state.

use rayon::prelude::*;

use crate::lattice::direction::Arc;
use crate::lattice::{LANES, LatticeMdp, outcome};

/// States `first .. end` of a row whose step ends with one outcome.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Run {
    pub first: u32,
    pub end: u32,
    pub code: u8,
    pub region: u8,
}

/// Grid points `first .. end` of a row that are in one region.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Piece {
    pub first: usize,
    pub end: usize,
    pub region: usize,
}

/// The pieces that all rows of a column of a sector have, and their runs: those of row `[heading][bevel]` are
/// `runs[starts[row] .. starts[row + 1]]`.
#[derive(Debug, Clone)]
pub(crate) struct Column {
    pub pieces: Vec<Piece>,
    starts: Vec<u32>,
    runs: Vec<Run>,
}

impl Column {
    #[inline(always)]
    pub(crate) fn row(&self, q: usize, bevel: usize) -> &[Run] {
        let row = q * 2 + bevel;
        &self.runs[self.starts[row] as usize..self.starts[row + 1] as usize]
    }
}

/// The runs of all sectors, `[sector][u]`.
pub(crate) type Endings = Vec<Vec<Column>>;

/// Finds the runs of `outcomes`, which are laid out as those of the lattice; rows are `lanes` long, with padding.
pub(crate) fn endings(lattice: &LatticeMdp, outcomes: &[u8]) -> Endings {
    Arc::all(&lattice.directions).into_iter().map(|arc| sector(lattice, outcomes, arc)).collect()
}

fn sector(lattice: &LatticeMdp, outcomes: &[u8], arc: Arc) -> Vec<Column> {
    let [rows, length] = arc.extent(lattice.shape);
    let padded = length.next_multiple_of(LANES);
    let column = |u: usize| {
        let row = if arc.direction.is_reversed() { rows - 1 - u } else { u };
        let mut pieces = pieces(lattice, arc.direction.is_vertical(), row, length);
        let mut column = Column { pieces: Vec::new(), starts: vec![0], runs: Vec::new() };
        for (q, bevel) in arc.planes() {
            let start = lattice.outcome_plane(arc.heading(q, lattice.shape.headings), bevel) + row * length;
            for piece in &pieces {
                scan(&outcomes[start..start + length], *piece, &mut column.runs);
            }
            // Only interpolation reads what is beyond the end of a row.
            if lattice.is_interpolated() && padded > length {
                column.runs.push(Run { first: length as u32, end: padded as u32, code: outcome::OUTSIDE, region: 0 });
            }
            column.starts.push(column.runs.len() as u32);
        }
        // Rows are computed with their padding.
        pieces.iter_mut().filter(|piece| piece.end == length).for_each(|piece| piece.end = padded);
        column.pieces = pieces;
        column
    };
    (0..rows).into_par_iter().map(column).collect()
}

/// The regions along a row of grid points: column i of the grid, or row j where the sector moves vertically.
fn pieces(lattice: &LatticeMdp, vertical: bool, row: usize, length: usize) -> Vec<Piece> {
    let ny = lattice.shape.ny;
    if lattice.region_of.is_empty() {
        return vec![Piece { first: 0, end: length, region: 0 }];
    }
    let region = |v: usize| lattice.region_of[if vertical { v * ny + row } else { row * ny + v }];
    let mut pieces: Vec<Piece> = Vec::new();
    for v in 0..length {
        let region = usize::from(region(v));
        match pieces.last_mut() {
            Some(piece) if piece.region == region => piece.end = v + 1,
            _ => pieces.push(Piece { first: v, end: v + 1, region }),
        }
    }
    pieces
}

/// Appends the runs of a piece of a row of codes.
fn scan(codes: &[u8], piece: Piece, runs: &mut Vec<Run>) {
    let mut first = piece.first;
    while first < piece.end {
        let code = codes[first];
        let end = first + run_length(&codes[first..piece.end], code);
        if code != outcome::CONTINUES {
            runs.push(Run { first: first as u32, end: end as u32, code, region: piece.region as u8 });
        }
        first = end;
    }
}

/// How many of the first codes are `code`; eight at a time.
fn run_length(codes: &[u8], code: u8) -> usize {
    let eight = [code; 8];
    let whole = codes.chunks_exact(8).take_while(|chunk| **chunk == eight).count() * 8;
    whole + codes[whole..].iter().take_while(|each| **each == code).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_what_a_look_at_every_state_finds() {
        for seed in 1..200u32 {
            let mut state = seed;
            let mut next = |n: u32| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 16) % n
            };
            let mut codes = Vec::new();
            while codes.len() < 60 {
                let code = next(6) as u8;
                codes.extend(vec![code; 1 + next(19) as usize]);
            }
            let mut runs = Vec::new();
            let half = codes.len() / 2;
            for (first, end, region) in [(0, half, 0), (half, codes.len(), 1)] {
                scan(&codes, Piece { first, end, region }, &mut runs);
            }
            let mut found = vec![outcome::CONTINUES; codes.len()];
            for run in &runs {
                assert!(run.first < run.end && run.code != outcome::CONTINUES);
                found[run.first as usize..run.end as usize].fill(run.code);
            }
            assert_eq!(found, codes);
            assert!(runs.windows(2).all(|pair| pair[0].end <= pair[1].first));
        }
    }
}
