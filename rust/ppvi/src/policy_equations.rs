//! The linear equations V = k + W V of a fixed policy, solved directly or iteratively.
//!
//! W is not negative, has no diagonal and spectral radius below one (a discount, or a proper policy), so I - W is a
//! nonsingular M-matrix. Two solvers:
//!
//! * *Direct*: LU factors without pivoting in a band, which are stable for M-matrices. Exact up to rounding.
//! * *Iterative*: BiCGStab (van der Vorst 1992) on the equations preconditioned from both sides by the triangular parts,
//!   (I - L)^-1 (I - L - U) (I - U)^-1. Eisenstat's identity I - L - U = (I - L) + (I - U) - I makes one application as
//!   cheap as one product with W.
//!
//! Neither result is trusted: the caller measures its residual.

use crate::stop::StopFlag;

/// Largest number of iterations of BiCGStab.
const MOST_ITERATIONS: usize = 300;

/// Largest number of multiplications of a direct solve, per state.
const MOST_WORK_PER_STATE: usize = 2_000;

/// Largest number of elements of a band.
const MOST_ELEMENTS: usize = 1 << 23;

/// Entries from which a row is summed by four sums side by side.
pub(crate) const LONG_ROW: usize = 12;

/// Smallest pivot that is not taken for rounding: the equations of a policy that may not end are singular.
const LEAST_PIVOT: f64 = 1e-13;

/// The equations, in compressed rows. The entries of a row with lower column numbers come first.
#[derive(Debug, Default)]
pub(crate) struct Equations {
    /// Entries of row i: `ends[i]..ends[i + 1]`; those of the lower triangle end at `middles[i]`.
    pub ends: Vec<u32>,
    pub middles: Vec<u32>,
    pub columns: Vec<u32>,
    pub weights: Vec<f64>,
    pub constants: Vec<f64>,
}

impl Equations {
    pub fn clear(&mut self) {
        self.ends.clear();
        self.ends.push(0);
        self.middles.clear();
        self.columns.clear();
        self.weights.clear();
        self.constants.clear();
    }

    /// Ends a row whose entries of the lower triangle have been appended, with its other entries.
    pub fn end_row(&mut self, constant: f64, upper: &mut Vec<(u32, f64)>) {
        self.middles.push(self.columns.len() as u32);
        for (column, weight) in upper.drain(..) {
            self.columns.push(column);
            self.weights.push(weight);
        }
        self.ends.push(self.columns.len() as u32);
        self.constants.push(constant);
    }

    pub fn len(&self) -> usize {
        self.constants.len()
    }

    #[inline]
    fn dot(&self, entries: std::ops::Range<u32>, values: &[f64]) -> f64 {
        let entries = entries.start as usize..entries.end as usize;
        dot_at(&self.columns[entries.clone()], &self.weights[entries], values)
    }

    /// One Gauss-Seidel sweep. Returns the largest change.
    pub fn sweep(&self, reverse: bool, values: &mut [f64]) -> f64 {
        let mut largest = 0.0f64;
        for index in 0..self.len() {
            let row = if reverse { self.len() - 1 - index } else { index };
            let new = self.constants[row] + self.dot(self.ends[row]..self.ends[row + 1], values);
            largest = largest.max((new - values[row]).abs());
            values[row] = new;
        }
        largest
    }

    /// Writes k + W V - V to `residual`, and returns its largest absolute value.
    pub fn residual(&self, values: &[f64], residual: &mut Vec<f64>) -> f64 {
        residual.clear();
        let element =
            |row: usize| self.constants[row] + self.dot(self.ends[row]..self.ends[row + 1], values) - values[row];
        residual.extend((0..self.len()).map(element));
        largest(residual)
    }

    /// Replaces x by (I - L)^-1 x.
    fn solve_lower(&self, x: &mut [f64]) {
        for row in 0..self.len() {
            x[row] += self.dot(self.ends[row]..self.middles[row], x);
        }
    }

    /// Replaces x by (I - U)^-1 x.
    fn solve_upper(&self, x: &mut [f64]) {
        for row in (0..self.len()).rev() {
            x[row] += self.dot(self.middles[row]..self.ends[row + 1], x);
        }
    }

    /// Writes (I - L)^-1 (I - L - U) (I - U)^-1 x to `image`.
    fn apply(&self, x: &[f64], image: &mut [f64], scratch: &mut [f64]) {
        scratch.copy_from_slice(x);
        self.solve_upper(scratch);
        for ((image, &x), &t) in image.iter_mut().zip(x).zip(scratch.iter()) {
            *image = x - t;
        }
        self.solve_lower(image);
        image.iter_mut().zip(scratch.iter()).for_each(|(image, t)| *image += t);
    }

    /// Returns the correction of values with this residual, to the relative accuracy `accuracy` in the preconditioned
    /// norm or as far as the iteration comes, and the number of products with W.
    pub fn correction(&self, residual: &[f64], accuracy: f64) -> (Vec<f64>, u64) {
        let n = self.len();
        let mut r = residual.to_vec();
        self.solve_lower(&mut r);
        let shadow = r.clone();
        let (mut x, mut p, mut v) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        let (mut t, mut scratch) = (vec![0.0; n], vec![0.0; n]);
        let (mut rho, mut alpha, mut omega) = (1.0, 1.0, 1.0);
        let mut products = 2;
        let wanted = accuracy * accuracy * dot(&r, &r);
        let stop = StopFlag::current();
        for _ in 0..MOST_ITERATIONS {
            stop.check();
            let next = dot(&shadow, &r);
            let beta = next / rho * (alpha / omega);
            rho = next;
            if !beta.is_finite() || rho == 0.0 {
                break;
            }
            for i in 0..n {
                p[i] = r[i] + beta * (p[i] - omega * v[i]);
            }
            self.apply(&p, &mut v, &mut scratch);
            alpha = rho / dot(&shadow, &v);
            if !alpha.is_finite() {
                break;
            }
            for i in 0..n {
                r[i] -= alpha * v[i];
            }
            self.apply(&r, &mut t, &mut scratch);
            products += 2;
            let square = dot(&t, &t);
            omega = if square > 0.0 { dot(&t, &r) / square } else { 0.0 };
            for i in 0..n {
                x[i] += alpha * p[i] + omega * r[i];
                r[i] -= omega * t[i];
            }
            if dot(&r, &r) <= wanted || omega == 0.0 {
                break;
            }
        }
        self.solve_upper(&mut x);
        (x, products)
    }

    /// The largest distance of an entry from the diagonal.
    fn bandwidth(&self) -> usize {
        let row = |row: usize| {
            let entries = self.ends[row] as usize..self.ends[row + 1] as usize;
            self.columns[entries].iter().map(|&column| (column as usize).abs_diff(row)).max().unwrap_or(0)
        };
        (0..self.len()).map(row).max().unwrap_or(0)
    }

    /// Solves the equations in a band. Returns None if the band is too wide to be worth it, or the equations seem
    /// singular.
    pub fn solve_in_band(&self) -> Option<Vec<f64>> {
        let (n, band) = (self.len(), self.bandwidth());
        let width = 2 * band + 1;
        if band * (band + 1) > MOST_WORK_PER_STATE || n * width > MOST_ELEMENTS {
            return None;
        }
        // Element (i, j) is at i * width + j + band - i.
        let mut matrix = vec![0.0; n * width];
        for row in 0..n {
            matrix[row * width + band] = 1.0;
            for entry in self.ends[row] as usize..self.ends[row + 1] as usize {
                matrix[row * width + self.columns[entry] as usize + band - row] -= self.weights[entry];
            }
        }
        let mut x = self.constants.clone();
        let stop = StopFlag::current();
        for row in 0..n {
            stop.check();
            let (above, current) = matrix.split_at_mut(row * width);
            for column in row.saturating_sub(band)..row {
                let place = column + band - row;
                if current[place] == 0.0 {
                    continue;
                }
                let pivot_row = &above[column * width..(column + 1) * width];
                let factor = current[place] / pivot_row[band];
                for offset in 1..=band {
                    current[place + offset] -= factor * pivot_row[band + offset];
                }
                x[row] -= factor * x[column];
            }
            if current[band] <= LEAST_PIVOT {
                return None;
            }
        }
        for row in (0..n).rev() {
            let above = &matrix[row * width + band + 1..(row + 1) * width];
            let known = &x[row + 1..n.min(row + 1 + band)];
            let sum = known.iter().zip(above).fold(0.0, |sum, (x, element)| sum + x * element);
            x[row] = (x[row] - sum) / matrix[row * width + band];
        }
        Some(x)
    }
}

/// The sum of the products of weights and of the values at these indices, always in the same order.
#[inline(always)]
pub(crate) fn dot_at(indices: &[u32], weights: &[f64], values: &[f64]) -> f64 {
    if indices.len() >= LONG_ROW {
        return long_dot_at(indices, weights, values);
    }
    indices.iter().zip(weights).fold(0.0, |sum, (&index, &weight)| sum + weight * values[index as usize])
}

/// [`dot_at`] by four sums side by side: an addition need not wait for the one before.
#[inline(never)]
fn long_dot_at(indices: &[u32], weights: &[f64], values: &[f64]) -> f64 {
    let product = |sum: f64, (&index, &weight): (&u32, &f64)| sum + weight * values[index as usize];
    let (mut sums, split) = ([0.0; 4], indices.len() / 4 * 4);
    for (indices, weights) in indices[..split].chunks_exact(4).zip(weights.chunks_exact(4)) {
        for lane in 0..4 {
            sums[lane] = product(sums[lane], (&indices[lane], &weights[lane]));
        }
    }
    let rest = indices[split..].iter().zip(&weights[split..]).fold(0.0, product);
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// Largest |x|; NaN if an element is.
pub(crate) fn largest(x: &[f64]) -> f64 {
    f64::from_bits(x.iter().fold(0, |most, x| x.abs().to_bits().max(most)))
}

/// Scalar product; four sums side by side, always in the same order.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (mut sums, split) = ([0.0; 4], a.len() / 4 * 4);
    for (a, b) in a[..split].chunks_exact(4).zip(b.chunks_exact(4)) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest = a[split..].iter().zip(&b[split..]).fold(0.0, |sum, (a, b)| sum + a * b);
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}
