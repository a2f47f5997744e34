//! Prediction and correction of an uncertain path of a needle, as a Kalman filter along its length needs them.
//!
//! The state of a place of the path is its mean, whose columns are position (3), heading, elevation, ratio of the
//! curvature to the planned curvature, roll of the bevel less roll of the base, drift of a tracker (3) and change of the
//! ratio per length, and its covariance. With curvature sensors along the needle, the integrals of heading, elevation
//! and roll over the present window follow, and then columns that stay constant along the path.
//!
//! [`moved`] is equations (1) to (6) of `docs/explanation/tip-estimation.md` over a piece of the path, as an arc, and
//! (2) of `docs/explanation/tip-fibre.md`; its Jacobian is one of central differences.

/// Number of columns of the path.
pub const PATH_SIZE: usize = 11;

/// Number of columns of the path and of the three integrals.
pub const SENSED_SIZE: usize = PATH_SIZE + ANGLES.len();

const HEADING: usize = 3;
const ELEVATION: usize = 4;
const FACTOR: usize = 5;
const ROLL: usize = 6;
const CHANGE: usize = 10;

/// The columns that are integrated.
const ANGLES: [usize; 3] = [HEADING, ELEVATION, ROLL];

/// The columns on which the next state depends nonlinearly, and the steps of their central differences.
const VARIED: [(usize, f64); 5] = [(HEADING, 1e-5), (ELEVATION, 1e-5), (FACTOR, 1e-4), (ROLL, 1e-5), (CHANGE, 1e-5)];

type Path = [f64; PATH_SIZE];
type Matrix = [[f64; SENSED_SIZE]; SENSED_SIZE];

/// A piece of the path: its length, mm, the means of cosine and sine of the roll of the base, and the rotation of the
/// base in it, rad. A piece that is not `fresh` is the straight line in front of the tissue.
#[derive(Debug, Clone, Copy)]
pub struct PathPiece {
    /// Length, mm.
    pub length: f64,
    /// Mean cosine of the roll.
    pub cos: f64,
    /// Mean sine of the roll.
    pub sin: f64,
    /// Rotation of the base, rad.
    pub turned: f64,
    /// Whether the tip has cut the piece in tissue.
    pub fresh: bool,
}

/// Standard deviations of the path, each per root of the length except that of the change, and its decay length, mm.
#[derive(Debug, Clone, Copy)]
pub struct PathNoise {
    /// Of the length, mm/sqrt(mm).
    pub slip: f64,
    /// Of heading and elevation, rad/sqrt(mm).
    pub heading: f64,
    /// Of the ratio of the curvature, 1/sqrt(mm).
    pub factor: f64,
    /// Of the change of this ratio, 1/mm.
    pub change: f64,
    /// Length over which a change decays to 1/e, mm.
    pub decay: f64,
    /// Of the roll, per root of the rotation of the base, rad/sqrt(rad).
    pub roll: f64,
}

impl PathNoise {
    /// The integral of exp(-s / decay) over a length, mm.
    fn gained(&self, length: f64) -> f64 {
        self.decay * -(-length / self.decay).exp_m1()
    }

    /// The mean of [`gained`](Self::gained) over a length, mm.
    fn mean_gained(&self, length: f64) -> f64 {
        if length < 1e-6 * self.decay { length / 2.0 } else { self.decay * (1.0 - self.gained(length) / length) }
    }
}

/// Moves a state and its covariance, row by row, to the end of a piece with a planned curvature, 1/mm.
///
/// # Panics
/// If the state has neither [`PATH_SIZE`] nor at least [`SENSED_SIZE`] columns, or the covariance another size.
pub fn moved(state: &mut [f64], covariance: &mut [f64], piece: &PathPiece, planned: f64, noise: &PathNoise) {
    let columns = state.len();
    let active = if columns == PATH_SIZE { PATH_SIZE } else { SENSED_SIZE };
    assert!(columns >= active && covariance.len() == columns * columns);
    covariance[ROLL * columns + ROLL] += noise.roll * noise.roll * piece.turned;
    let mut before: Path = [0.0; PATH_SIZE];
    before.copy_from_slice(&state[..PATH_SIZE]);
    let (after, mut transition) = linearised(&before, piece, planned, noise);
    let mut added = process_noise(&before, &after, piece, noise);
    state[..PATH_SIZE].copy_from_slice(&after);
    let half = piece.length / 2.0;
    for (sum, angle) in (PATH_SIZE..active).zip(ANGLES) {
        // The trapezoidal rule.
        state[sum] += half * (before[angle] + after[angle]);
        transition[sum] = transition[angle].map(|value| half * value);
        transition[sum][angle] += half;
        transition[sum][sum] = 1.0;
    }
    if piece.fresh {
        // An angle w is a random walk with the variance v over the length L. Its integral I over the piece has
        // cov(w, I) = v L / 2 and var(I) = v L^2 / 3. The position y across the path is the same integral, so that
        // cov(y, I) = v L^2 / 3, and cov(y, w) = v L / 2.
        for (sum, angle) in (PATH_SIZE..active).zip(ANGLES) {
            let shared: Path =
                std::array::from_fn(|row| half * added[row][angle] * if row < 3 { 4.0 / 3.0 } else { 1.0 });
            for (row, value) in shared.into_iter().enumerate() {
                (added[row][sum], added[sum][row]) = (value, value);
            }
        }
        for (row, angle) in (PATH_SIZE..active).zip(ANGLES) {
            for (column, other) in (PATH_SIZE..active).zip(ANGLES) {
                added[row][column] = piece.length * piece.length / 3.0 * added[angle][other];
            }
        }
    }
    let mut rows = vec![0.0; active * columns];
    for (row, weights) in rows.chunks_exact_mut(columns).zip(&transition) {
        for (source, weight) in covariance.chunks_exact(columns).zip(&weights[..active]) {
            if *weight != 0.0 {
                row.iter_mut().zip(source).for_each(|(sum, value)| *sum += weight * value);
            }
        }
    }
    for (a, row) in rows.chunks_exact(columns).enumerate() {
        for b in 0..columns {
            let value = match b {
                _ if b >= active => row[b],
                _ if b > a => continue,
                _ => added[a][b] + (0..active).map(|k| row[k] * transition[b][k]).sum::<f64>(),
            };
            covariance[a * columns + b] = value;
            covariance[b * columns + a] = value;
        }
    }
}

/// Corrects a state and its covariance with a measurement of two numbers, and returns the normalised squared
/// innovation. Nothing changes if this is above `gate`, or not a number.
///
/// `model` holds the derivatives of both numbers by each of the `columns`; both have noise of the same `variance`.
///
/// # Panics
/// If a column is not in the state, or the covariance has another size.
pub fn corrected(
    state: &mut [f64],
    covariance: &mut [f64],
    columns: &[usize],
    model: &[[f64; 2]],
    innovation: [f64; 2],
    variance: f64,
    gate: f64,
) -> f64 {
    let across: Vec<[f64; 2]> = covariance
        .chunks_exact(state.len())
        .map(|row| [0, 1].map(|k| columns.iter().zip(model).map(|(&column, weights)| row[column] * weights[k]).sum()))
        .collect();
    let spread = |a: usize, b: usize| -> f64 {
        columns.iter().zip(model).map(|(&column, weights)| weights[a] * across[column][b]).sum()
    };
    let (first, mixed, second) = (spread(0, 0) + variance, spread(0, 1), spread(1, 1) + variance);
    let determinant = first * second - mixed * mixed;
    let solved = |[a, b]: [f64; 2]| [(second * a - mixed * b) / determinant, (first * b - mixed * a) / determinant];
    let [u, v] = solved(innovation);
    let squared = innovation[0] * u + innovation[1] * v;
    if squared <= gate {
        for ((value, row), pair) in state.iter_mut().zip(covariance.chunks_exact_mut(across.len())).zip(&across) {
            *value += pair[0] * u + pair[1] * v;
            let gain = solved(*pair);
            row.iter_mut().zip(&across).for_each(|(sum, [a, b])| *sum -= gain[0] * a + gain[1] * b);
        }
    }
    squared
}

/// The state at the end of a piece, and the derivative of this state by the one at the beginning.
fn linearised(before: &Path, piece: &PathPiece, planned: f64, noise: &PathNoise) -> (Path, Matrix) {
    let mut transition = [[0.0; SENSED_SIZE]; SENSED_SIZE];
    (0..PATH_SIZE).for_each(|k| transition[k][k] = 1.0);
    for (column, step) in VARIED {
        let [above, below] = [step, -step].map(|shift| {
            let mut shifted = *before;
            shifted[column] += shift;
            along(&shifted, piece, planned, noise)
        });
        for row in 0..PATH_SIZE {
            transition[row][column] = (above[row] - below[row]) / (2.0 * step);
        }
    }
    (along(before, piece, planned, noise), transition)
}

/// The state at the end of a piece, which counts with its mean curvature: exact for a constant roll and ratio.
fn along(state: &Path, piece: &PathPiece, planned: f64, noise: &PathNoise) -> Path {
    let mean = state[FACTOR] + state[CHANGE] * noise.mean_gained(piece.length);
    let bend = if piece.fresh { mean * planned } else { 0.0 };
    let (sin_r, cos_r) = state[ROLL].sin_cos();
    let (left, up) = (piece.cos * cos_r - piece.sin * sin_r, piece.sin * cos_r + piece.cos * sin_r);
    let size = left.hypot(up);
    let (left, up) = if size > 0.0 { (left / size, up / size) } else { (left, up) };
    let turn = bend * size * piece.length;
    let (sin_half, cos_half) = (turn / 2.0).sin_cos();
    let chord = if turn == 0.0 { piece.length } else { piece.length * sin_half / (turn / 2.0) };
    let (forward, aside) = (chord * cos_half, chord * sin_half);
    let ((sin_h, cos_h), (sin_e, cos_e)) = (state[HEADING].sin_cos(), state[ELEVATION].sin_cos());
    let (sin_t, cos_t) = turn.sin_cos();
    let level = forward * cos_e - aside * up * sin_e;
    let mut after = *state;
    after[0] += level * cos_h - aside * left * sin_h;
    after[1] += level * sin_h + aside * left * cos_h;
    after[2] += forward * sin_e + aside * up * cos_e;
    let turned = (sin_t * left).atan2(cos_t * cos_e - sin_t * up * sin_e);
    after[HEADING] += turned;
    after[ELEVATION] = (cos_t * sin_e + sin_t * up * cos_e).clamp(-1.0, 1.0).asin();
    after[ROLL] -= turned * ((state[ELEVATION] + after[ELEVATION]) / 2.0).sin();
    if piece.fresh {
        after[FACTOR] += state[CHANGE] * noise.gained(piece.length);
        after[CHANGE] *= (-piece.length / noise.decay).exp();
    }
    after
}

/// The process noise of a piece: slip, and in fresh tissue the random walks of the tangent and of the ratio.
fn process_noise(before: &Path, after: &Path, piece: &PathPiece, noise: &PathNoise) -> Matrix {
    let length = piece.length;
    let (sin_h, cos_h) = ((before[HEADING] + after[HEADING]) / 2.0).sin_cos();
    let (sin_e, cos_e) = ((before[ELEVATION] + after[ELEVATION]) / 2.0).sin_cos();
    let forward = [cos_e * cos_h, cos_e * sin_h, sin_e];
    let (left, up) = ([-sin_h, cos_h, 0.0], [-sin_e * cos_h, -sin_e * sin_h, cos_e]);
    let variance = if piece.fresh { noise.heading * noise.heading } else { 0.0 };
    let mut added = [[0.0; SENSED_SIZE]; SENSED_SIZE];
    for a in 0..3 {
        for b in 0..3 {
            added[a][b] = noise.slip * noise.slip * length * forward[a] * forward[b]
                + variance * length.powi(3) / 3.0 * (left[a] * left[b] + up[a] * up[b]);
        }
    }
    if !piece.fresh {
        return added;
    }
    let (once, twice, thrice) = (variance * length, variance * length.powi(2) / 2.0, variance * length.powi(2) / 3.0);
    // A random walk of the heading turns the fixed plane below the transported roll, at every elevation; that of the
    // elevation is coupled to the roll while the heading turns.
    let (level, turn) = (-sin_e / cos_e, before[HEADING] - after[HEADING]);
    let mut pair = |a: usize, b: usize, value: f64| (added[a][b], added[b][a]) = (value, value);
    for axis in 0..3 {
        pair(axis, HEADING, twice / cos_e * left[axis]);
        pair(axis, ELEVATION, twice * up[axis]);
        pair(axis, ROLL, twice * level * left[axis] + thrice * turn * up[axis]);
    }
    pair(HEADING, HEADING, once / (cos_e * cos_e));
    pair(ELEVATION, ELEVATION, once);
    pair(HEADING, ROLL, once * level / cos_e);
    pair(ELEVATION, ROLL, once * turn / 2.0);
    pair(ROLL, ROLL, once * level * level + once * turn * turn / 3.0);
    pair(FACTOR, FACTOR, noise.factor * noise.factor * length);
    // The noise of the change within a piece hardly moves the ratio in the same piece: only its own variance counts.
    pair(CHANGE, CHANGE, noise.change * noise.change * -(-2.0 * length / noise.decay).exp_m1());
    added
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_that_is_measured_well_is_known_well() {
        let (mut state, mut covariance) = (vec![0.0; PATH_SIZE], vec![0.0; PATH_SIZE * PATH_SIZE]);
        (0..PATH_SIZE).for_each(|k| covariance[k * PATH_SIZE + k] = 1.0);
        covariance[HEADING] = 0.5;
        covariance[HEADING * PATH_SIZE] = 0.5;
        let model = [[1.0, 0.0], [0.0, 1.0]];
        let mut measure = |gate| corrected(&mut state, &mut covariance, &[0, 1], &model, [2.0, 0.0], 1e-12, gate);
        assert!((measure(1.0) - 4.0).abs() < 1e-6);
        measure(5.0);
        assert!((state[0] - 2.0).abs() < 1e-6 && (state[HEADING] - 1.0).abs() < 1e-6);
        assert!(covariance[0] < 1e-11 && (covariance[HEADING * (PATH_SIZE + 1)] - 0.75).abs() < 1e-6);
    }

    #[test]
    fn in_front_of_the_tissue_the_path_is_straight() {
        let mut state = vec![0.0; SENSED_SIZE];
        (state[HEADING], state[FACTOR]) = (0.5, 1.0);
        let mut covariance = vec![0.0; SENSED_SIZE * SENSED_SIZE];
        let piece = PathPiece { length: 10.0, cos: 0.0, sin: 0.0, turned: 0.0, fresh: false };
        let noise = PathNoise { slip: 0.1, heading: 0.1, factor: 0.1, change: 0.1, decay: 50.0, roll: 0.1 };
        moved(&mut state, &mut covariance, &piece, 0.025, &noise);
        assert!((state[0] - 10.0 * 0.5f64.cos()).abs() < 1e-12 && (state[1] - 10.0 * 0.5f64.sin()).abs() < 1e-12);
        assert_eq!((state[HEADING], state[PATH_SIZE]), (0.5, 5.0));
        assert!((covariance[0] + covariance[SENSED_SIZE + 1] - 0.1).abs() < 1e-12);
        assert_eq!(covariance[HEADING * (SENSED_SIZE + 1)], 0.0);
    }
}
