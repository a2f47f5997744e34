//! Bristles of friction along a sampled motion: states between -1 and 1 that follow the direction of sliding.
//!
//! Velocities are linear between samples. Every function returns the state at each sample.

/// Newton step below which a sliding distance counts as converged, mm.
const SLID_MM: f64 = 1e-9;
/// Pull between sticking and sliding below which the friction counts as complete, mm.
const LOOSE_MM: f64 = 1e-12;
/// Largest number of Newton steps.
const MOST_STEPS: usize = 50;

/// Sign of a number, 0 for 0.
fn sign(value: f64) -> f64 {
    if value > 0.0 {
        1.0
    } else if value < 0.0 {
        -1.0
    } else {
        0.0
    }
}

/// Dahl's bristle z, z' = (v - |v| z) / length, in the samples of `found`, for velocities (mm/s) at times (s).
///
/// Exact, reversals within a step included: on each side of a reversal, z approaches the sign of the velocity
/// exponentially with the travel.
///
/// # Examples
/// ```
/// let mut z = [0.0; 2];
/// needle::bristle::slid(&[1.0, 1.0], &[0.0, 2.0], 0.5, 0.0, &mut z);
/// assert!((z[1] - (1.0 - (-4.0f64).exp())).abs() < 1e-15);
/// ```
pub fn slid(velocity: &[f64], time: &[f64], length_mm: f64, start: f64, found: &mut [f64]) {
    let mut z = start;
    if let Some(first) = found.first_mut() {
        *first = z;
    }
    for (k, next) in found.iter_mut().enumerate().skip(1) {
        let (before, after, h) = (velocity[k - 1], velocity[k], time[k] - time[k - 1]);
        let share = if before * after < 0.0 { before / (before - after) } else { 1.0 };
        let parts = if share < 1.0 {
            [before * share / 2.0 * h, after * (1.0 - share) / 2.0 * h]
        } else {
            [(before + after) / 2.0 * h, 0.0]
        };
        for way in parts {
            if way != 0.0 {
                let end = sign(way);
                z = end + (z - end) * (-way.abs() / length_mm).exp();
            }
        }
        *next = z;
    }
}

/// Mean of elastoplastic elements in the samples of `found`: each stretches by 1 over its yield travel, in units of
/// `length_mm`, and slides at -1 and 1.
pub fn yielding(velocity: &[f64], time: &[f64], length_mm: f64, yields: &[f64], found: &mut [f64]) {
    let mut elements = vec![0.0; yields.len()];
    let stiff: Vec<f64> = yields.iter().map(|travel| 1.0 / (length_mm * travel)).collect();
    let mut mean = 0.0;
    for (k, next) in found.iter_mut().enumerate().skip(1) {
        let (before, after, h) = (velocity[k - 1], velocity[k], time[k] - time[k - 1]);
        let way = (before + after) / 2.0 * h;
        if way != 0.0 {
            for (element, stiff) in elements.iter_mut().zip(&stiff) {
                *element = (*element + way * stiff).clamp(-1.0, 1.0);
            }
            mean = elements.iter().sum::<f64>() / elements.len() as f64;
        }
        *next = mean;
    }
}

/// Tissue that friction displaces, at each sample.
#[derive(Debug, Clone, Copy)]
pub struct Compliance<'a> {
    /// Displacement (mm) that complete friction causes, at each sample.
    pub largest_mm: &'a [f64],
    /// Damping over stiffness, s.
    pub lag_s: f64,
    /// Travel over which the friction reverses, mm.
    pub presliding_mm: f64,
}

impl Compliance<'_> {
    /// Bristle z and tissue displacement u (mm) in the samples of `bristle` and `moved`, whose first ones are the start.
    ///
    /// lag u' = s z - u by the trapezoidal rule. The bristle depends exponentially on the sliding distance of a step,
    /// which is the root of a decreasing convex function: Newton's method converges to it from below.
    pub fn drag(&self, velocity: &[f64], time: &[f64], bristle: &mut [f64], moved: &mut [f64]) {
        let length = self.presliding_mm;
        for k in 1..velocity.len() {
            let (z, u, h) = (bristle[k - 1], moved[k - 1], time[k] - time[k - 1]);
            let (stiff, way) = (self.lag_s / h + 0.5, (velocity[k] + velocity[k - 1]) / 2.0 * h);
            let size = self.largest_mm[k];
            let pull = u + stiff * way - (size + self.largest_mm[k - 1]) / 2.0 * z;
            let sign = if pull < 0.0 { -1.0 } else { 1.0 };
            let (pull, bent) = (sign * pull, sign * z);
            let loose = size * (1.0 - bent) / 2.0; // pull above which the needle keeps sliding
            let mut slid = if pull > loose { (pull - loose) / stiff } else { 0.0 };
            bristle[k] = sign;
            if loose >= LOOSE_MM {
                for _ in 0..if pull == 0.0 { 0 } else { MOST_STEPS } {
                    let rest = (-slid / length).exp();
                    let more = (pull - stiff * slid - loose * (1.0 - rest)) / (stiff + loose * rest / length);
                    slid += more;
                    if more.abs() < SLID_MM {
                        break;
                    }
                }
                bristle[k] = sign * (1.0 - (1.0 - bent) * (-slid / length).exp());
            }
            moved[k] = u + way - sign * slid;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reversal_within_a_step_is_two_travels() {
        let (mut whole, mut parts) = ([0.0; 2], [0.0; 3]);
        slid(&[2.0, -2.0], &[0.0, 1.0], 0.3, 0.1, &mut whole);
        slid(&[2.0, 0.0, -2.0], &[0.0, 0.5, 1.0], 0.3, 0.1, &mut parts);
        assert!((whole[1] - parts[2]).abs() < 1e-15);
    }

    #[test]
    fn stiff_tissue_does_not_change_the_bristle() {
        let time: Vec<f64> = (0..200).map(|k| 0.01 * f64::from(k)).collect();
        let velocity: Vec<f64> = time.iter().map(|t| 5.0 * (6.0 * t).cos()).collect();
        let (mut plain, mut bristle, mut moved) = ([0.0; 200], [0.0; 200], [0.0; 200]);
        slid(&velocity, &time, 0.4, 0.0, &mut plain);
        let tissue = Compliance { largest_mm: &[1e-9; 200], lag_s: 0.1, presliding_mm: 0.4 };
        tissue.drag(&velocity, &time, &mut bristle, &mut moved);
        let apart = plain.iter().zip(bristle).map(|(one, other)| (one - other).abs()).fold(0.0, f64::max);
        assert!(apart < 2e-2 && moved.iter().all(|u| u.abs() <= 1e-9));
    }
}
