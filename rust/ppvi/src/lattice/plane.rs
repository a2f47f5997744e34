//! Copies of planes (one heading, one bevel, all grid points) between arrays of different layout, transposed where the
//! one is stored by columns and the other by rows.

/// Size of a tile.
const ROWS: usize = 8;
const COLUMNS: usize = 4;

/// Where a plane stands in an array: element `(row, column)` at `start + row * stride + column`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plane {
    pub start: usize,
    pub stride: usize,
}

impl Plane {
    #[inline(always)]
    fn at(&self, row: usize) -> usize {
        self.start + self.stride * row
    }
}

/// Copies `rows` x `columns` elements; with `transposed`, row r of `from` becomes column r of `to`.
#[inline(always)]
pub(crate) fn copy<A: Copy, B: Copy>(
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
        let row = &from[from_at.at(r)..][..columns];
        for (to, value) in to[to_at.at(r)..][..columns].iter_mut().zip(row) {
            *to = convert(*value);
        }
    }
}

/// `to[(c, r)] = convert(from[(r, c)])`, in tiles that fit the registers.
#[inline(always)]
fn transpose<A: Copy, B: Copy>(
    from: &[A],
    from_at: Plane,
    to: &mut [B],
    to_at: Plane,
    [rows, columns]: [usize; 2],
    convert: impl Fn(A) -> B,
) {
    let whole_rows = rows / ROWS * ROWS;
    for r in (0..whole_rows).step_by(ROWS) {
        // Arrays of known length, and every element by its name: the compiler makes shuffles of that.
        let line = |k: usize| from[from_at.at(r + k)..][..columns].as_chunks::<COLUMNS>().0;
        let (l0, l1, l2, l3) = (line(0), line(1), line(2), line(3));
        let (l4, l5, l6, l7) = (line(4), line(5), line(6), line(7));
        let mut start = to_at.at(0) + r;
        for c in 0..columns / COLUMNS {
            let (a, b, c, d, e, f, g, h) = (l0[c], l1[c], l2[c], l3[c], l4[c], l5[c], l6[c], l7[c]);
            for k in 0..COLUMNS {
                let column = [
                    convert(a[k]),
                    convert(b[k]),
                    convert(c[k]),
                    convert(d[k]),
                    convert(e[k]),
                    convert(f[k]),
                    convert(g[k]),
                    convert(h[k]),
                ];
                to[start..start + ROWS].copy_from_slice(&column);
                start += to_at.stride;
            }
        }
    }
    for r in 0..rows {
        let first = if r < whole_rows { columns / COLUMNS * COLUMNS } else { 0 };
        let row = &from[from_at.at(r)..][..columns];
        for (c, value) in row.iter().enumerate().skip(first) {
            to[to_at.at(c) + r] = convert(*value);
        }
    }
}

/// `to.copy_from_slice(from)`, quick for the numbers of planes that the noise of the thesis asks for.
#[inline(always)]
pub(crate) fn copy_few<A: Copy>(to: &mut [A], from: &[A]) {
    match (to, from) {
        ([to], [from]) => *to = *from,
        ([a, b, c], [x, y, z]) => (*a, *b, *c) = (*x, *y, *z),
        (to, from) => to.copy_from_slice(from),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_element_lands_where_the_definition_says() {
        for (rows, columns) in [(1, 1), (8, 8), (9, 17), (16, 5), (31, 24)] {
            let from: Vec<u32> = (0..rows * 40).map(|x| x as u32).collect();
            let mut to = vec![u64::MAX; columns * 50];
            let (a, b) = (Plane { start: 3, stride: 40 }, Plane { start: 5, stride: 50 });
            let from = [from, vec![0; 40]].concat();
            transpose(&from, a, &mut to, b, [rows, columns], |x| u64::from(x) + 1);
            let mut written = 0;
            for (r, c) in (0..rows).flat_map(|r| (0..columns).map(move |c| (r, c))) {
                assert_eq!(to[5 + c * 50 + r], (3 + r * 40 + c) as u64 + 1);
                written += 1;
            }
            assert_eq!(to.iter().filter(|x| **x != u64::MAX).count(), written);
        }
    }
}
