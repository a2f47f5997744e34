//! Copies of planes (one heading, one bevel, all grid points) between arrays of different layout, transposed where the
//! one is stored by columns and the other by rows.

use std::array::from_fn;

const TILE: usize = 8;

/// Where a plane stands in an array: element `(row, column)` at `start + row * stride + column`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plane {
    pub start: usize,
    pub stride: usize,
    /// Row r stands where row `rows - 1 - r` would.
    pub reversed: bool,
}

impl Plane {
    #[inline(always)]
    fn at(&self, row: usize, rows: usize) -> usize {
        self.start + self.stride * if self.reversed { rows - 1 - row } else { row }
    }
}

/// Copies `rows` x `columns` elements; with `transposed`, row r of `from` becomes column r of `to`.
#[inline(always)]
pub(crate) fn copy<A: Copy + Default, B: Copy>(
    (from, from_at): (&[A], Plane),
    (to, to_at): (&mut [B], Plane),
    [rows, columns]: [usize; 2],
    transposed: bool,
    convert: impl Fn(A) -> B,
) {
    if transposed {
        return transpose(from, from_at, to, to_at, [rows, columns], convert);
    }
    for r in 0..rows {
        let row = &from[from_at.at(r, rows)..][..columns];
        for (to, value) in to[to_at.at(r, rows)..][..columns].iter_mut().zip(row) {
            *to = convert(*value);
        }
    }
}

/// `to[(c, r)] = convert(from[(r, c)])`, in tiles that fit the registers.
#[inline(always)]
fn transpose<A: Copy + Default, B: Copy>(
    from: &[A],
    from_at: Plane,
    to: &mut [B],
    to_at: Plane,
    [rows, columns]: [usize; 2],
    convert: impl Fn(A) -> B,
) {
    let (whole_rows, whole_columns) = (rows / TILE * TILE, columns / TILE * TILE);
    for r in (0..whole_rows).step_by(TILE) {
        let lines: [usize; TILE] = from_fn(|k| from_at.at(r + k, rows));
        for c in (0..whole_columns).step_by(TILE) {
            let tile: [&[A]; TILE] = lines.map(|line| &from[line + c..][..TILE]);
            for k in 0..TILE {
                let column: [B; TILE] = from_fn(|line| convert(tile[line][k]));
                to[to_at.at(c + k, columns) + r..][..TILE].copy_from_slice(&column);
            }
        }
    }
    let mut rest = |r: usize, c: usize| to[to_at.at(c, columns) + r] = convert(from[from_at.at(r, rows) + c]);
    for c in whole_columns..columns {
        (0..rows).for_each(|r| rest(r, c));
    }
    for c in 0..whole_columns {
        (whole_rows..rows).for_each(|r| rest(r, c));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_element_lands_where_the_definition_says() {
        for (rows, columns) in [(1, 1), (8, 8), (9, 17), (16, 5), (31, 24)] {
            for (turn_from, turn_to) in [(false, false), (true, false), (false, true), (true, true)] {
                let from: Vec<u32> = (0..rows * 40).map(|x| x as u32).collect();
                let mut to = vec![u64::MAX; columns * 50];
                let a = Plane { start: 3, stride: 40, reversed: turn_from };
                let b = Plane { start: 5, stride: 50, reversed: turn_to };
                let from = [from, vec![0; 40]].concat();
                transpose(&from, a, &mut to, b, [rows, columns], |x| u64::from(x) + 1);
                let mut written = 0;
                for r in 0..rows {
                    for c in 0..columns {
                        let (fr, tc) =
                            (if turn_from { rows - 1 - r } else { r }, if turn_to { columns - 1 - c } else { c });
                        assert_eq!(to[5 + tc * 50 + r], (3 + fr * 40 + c) as u64 + 1);
                        written += 1;
                    }
                }
                assert_eq!(to.iter().filter(|x| **x != u64::MAX).count(), written);
            }
        }
    }
}
