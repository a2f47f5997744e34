//! Random numbers of executions.

use rand::SeedableRng;
use rand::rand_core::Rng;
use rand_xoshiro::Xoshiro256PlusPlus;

/// The random stream of a run: seed and run number, mixed by splitmix64 inside `seed_from_u64`.
pub(crate) fn stream(seed: u64, run: u64) -> Xoshiro256PlusPlus {
    let spread = run.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(32);
    Xoshiro256PlusPlus::seed_from_u64(seed ^ spread)
}

/// Two independent standard normal numbers (Box and Muller 1958).
pub(crate) fn normal_pair(random: &mut Xoshiro256PlusPlus) -> [f64; 2] {
    let mut uniform = || ((random.next_u64() >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
    let (radius, (sin, cos)) = ((-2.0 * uniform().ln()).sqrt(), (std::f64::consts::TAU * uniform()).sin_cos());
    [radius * cos, radius * sin]
}
