//! Which steps of a sector end the execution, in the order in which a sweep reads them.
//!
//! A sweep goes through a column in strips of [`LANES`] grid points, and through a strip heading by heading. Every step
//! is computed as if it continued, and replaced where its code says how it ends: vector code without a branch.

use rayon::prelude::*;

use crate::lattice::direction::{Arc, Direction};
use crate::lattice::parts::{LANES, LatticeParts, Motion, Shape, outcome};
use crate::memory::filled;
use crate::stop::StopFlag;

/// Grid points `first .. end` of a column from which steps are of one region.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Piece {
    pub first: usize,
    pub end: usize,
    pub region: usize,
}

/// The outcomes of the steps of a sector, and their regions.
#[derive(Debug, Clone)]
pub(crate) struct TerminalMask {
    /// By motion: `[place][strip][heading][bevel][LANES]`; the padding of the last strip is `OUTSIDE`.
    codes: Vec<Vec<u8>>,
    /// Codes of a strip.
    strip: usize,
    /// Strips of a column.
    strips: usize,
    /// By place; together they are a column with its padding.
    pieces: Vec<Vec<Piece>>,
}

impl TerminalMask {
    /// The codes of the steps of a motion from a strip, `[heading][bevel]`.
    #[inline(always)]
    pub(crate) fn strip(&self, motion: Motion, place: usize, strip: usize) -> &[[[u8; LANES]; 2]] {
        let codes = &self.codes[motion as usize][(place * self.strips + strip) * self.strip..][..self.strip];
        codes.as_chunks::<LANES>().0.as_chunks::<2>().0
    }

    /// The regions along the column at `place`.
    pub(crate) fn pieces(&self, place: usize) -> &[Piece] {
        &self.pieces[place]
    }
}

/// The terminal masks of all sectors, from `outcomes` in the layout of the lattice.
pub(crate) fn terminal_masks(parts: &LatticeParts, directions: &[Direction], outcomes: &[u8]) -> Vec<TerminalMask> {
    Arc::all(directions).into_iter().map(|arc| terminal_mask(parts, outcomes, arc)).collect()
}

fn terminal_mask(parts: &LatticeParts, outcomes: &[u8], arc: Arc) -> TerminalMask {
    let [places, length] = arc.extent(parts.shape);
    let (strips, strip) = (length.div_ceil(LANES), arc.count * 2 * LANES);
    let codes = parts.motions().iter().map(|motion| codes(parts.shape, outcomes, arc, *motion)).collect();
    let pieces = (0..places).map(|place| pieces(parts, arc.direction, place, length)).collect();
    TerminalMask { codes, strip, strips, pieces }
}

/// The codes of the steps of a motion in the order of a sweep.
fn codes(shape: Shape, outcomes: &[u8], arc: Arc, motion: Motion) -> Vec<u8> {
    let [places, length] = arc.extent(shape);
    let strips = length.div_ceil(LANES);
    let strip = arc.count * 2 * LANES;
    let mut codes = filled(outcome::OUTSIDE, places * strips * strip);
    let stop = StopFlag::current();
    codes.par_chunks_exact_mut(strips * strip).enumerate().for_each(|(place, column)| {
        stop.check();
        for (plane, (q, bevel)) in arc.planes().enumerate() {
            let start = shape.plane(motion, arc.heading(q, shape.headings), bevel) + place * length;
            let (whole, rest) = outcomes[start..start + length].as_chunks::<LANES>();
            for (number, chunk) in whole.iter().enumerate() {
                column[number * strip + plane * LANES..][..LANES].copy_from_slice(chunk);
            }
            let last = whole.len() * strip + plane * LANES;
            column.iter_mut().skip(last).zip(rest).for_each(|(code, from)| *code = *from);
        }
    });
    codes
}

/// The regions along a column of a sector: column i of the grid, or row j where the sector moves vertically.
fn pieces(parts: &LatticeParts, direction: Direction, place: usize, length: usize) -> Vec<Piece> {
    let padded = length.next_multiple_of(LANES);
    if parts.region_of.is_empty() {
        return vec![Piece { first: 0, end: padded, region: 0 }];
    }
    let region = |v: usize| {
        let (i, j) = if direction.is_vertical() { (v, place) } else { (place, v) };
        direction.region(parts, i, j)
    };
    let mut pieces: Vec<Piece> = Vec::new();
    for v in 0..padded {
        let region = region(v.min(length - 1));
        match pieces.last_mut() {
            Some(piece) if piece.region == region => piece.end = v + 1,
            _ => pieces.push(Piece { first: v, end: v + 1, region }),
        }
    }
    pieces
}
