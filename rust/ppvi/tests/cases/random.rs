//! Random problems, also unpleasant ones, from a seed.

use std::f64::consts::TAU;

use ppvi::lattice::{
    Costs, Direction, HeadingKernel, LatticeMdp, LatticeParts, Motion, Region, Shape, Shift, Transition, outcome,
};

use super::Rows;

/// A generator of random numbers (splitmix64).
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A number below `end`.
    pub fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }

    pub fn chance(&mut self, percent: usize) -> bool {
        self.below(100) < percent
    }

    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A number whose logarithm is uniform.
    pub fn scale(&mut self, low: f64, high: f64) -> f64 {
        self.uniform(low.ln(), high.ln()).exp()
    }

    pub fn one_of<T: Clone>(&mut self, choices: &[T]) -> T {
        choices[self.below(choices.len())].clone()
    }

    pub fn discount(&mut self) -> f64 {
        if self.chance(50) { 1.0 } else { self.one_of(&[0.3, 0.9, 0.95, 0.99, 0.999, 0.999_999]) }
    }
}

/// Rows and a discount: costs of any size, some of them zero, rows whose sum is not quite one, rare transitions.
pub fn rows(random: &mut Random) -> (Rows, f64) {
    let (states, discount) = (1 + random.below(24), random.discount());
    let (size, free) = (random.scale(1e-3, 1e6), if random.chance(15) { 30 } else { 0 });
    let (uneven, rare) = (random.chance(25), random.chance(25));
    let row = |random: &mut Random| {
        let count = 1 + random.below(4);
        let mut weights: Vec<f64> = (0..count).map(|_| random.uniform(0.05, 1.0)).collect();
        if rare {
            weights[0] = random.scale(1e-6, 1.0);
        }
        if random.chance(10) {
            weights.push(0.0);
        }
        let total: f64 = weights.iter().sum();
        let excess = if uneven { 1.0 + random.uniform(-0.99e-9, 0.99e-9) } else { 1.0 };
        let entries = weights.iter().map(|w| (random.below(states) as u32, (w / total * excess).min(1.0)));
        let entries: Vec<(u32, f64)> = entries.collect();
        let sign = if discount < 1.0 && random.chance(10) { -1.0 } else { 1.0 };
        (if random.chance(free) { 0.0 } else { sign * size * random.uniform(0.1, 10.0) }, entries)
    };
    let rows = (0..states).map(|_| (0..random.below(4)).map(|_| row(random)).collect()).collect();
    (rows, discount)
}

/// A change of the heading: the thesis' one cell with noise, any turn with any noise, or any probabilities.
fn kernel(random: &mut Random, side: f64) -> ppvi::Result<HeadingKernel> {
    let noises = [
        vec![1.0],
        vec![0.5, 0.25],
        vec![0.466, 0.24, 0.027],
        vec![0.5, 0.0, 0.25],
        vec![0.0, 0.5],
        vec![0.3, 0.2, 0.1, 0.05],
        vec![1.0 - 9e-10],
        vec![0.466 - 9e-10, 0.24, 0.027],
    ];
    let noise = random.one_of(&noises);
    match random.below(6) {
        0 | 1 => HeadingKernel::matched(side, &noise, 1.0),
        2 => HeadingKernel::matched(0.0, &noise, random.uniform(0.2, 2.0)),
        3 | 4 => HeadingKernel::matched(side * random.uniform(0.0, 3.0), &noise, random.uniform(0.2, 2.0)),
        _ => {
            let weights: Vec<f64> = (0..1 + random.below(6)).map(|_| random.uniform(0.01, 1.0)).collect();
            let (total, first) = (weights.iter().sum::<f64>(), random.below(9) as i32 - 6);
            HeadingKernel::new((first..).zip(weights.iter().map(|weight| weight / total)).collect())
        }
    }
}

/// A lattice of up to about 250 states: steps and turns of any size, also far below a cell, in up to three regions, with
/// obstacles and a target.
pub fn lattice(random: &mut Random) -> ppvi::Result<LatticeMdp> {
    let shape = Shape { nx: 2 + random.below(6), ny: 1 + random.below(4), headings: 1 + random.below(8) };
    let Shape { nx, ny, headings } = shape;
    let transition = random.one_of(&[Transition::Nearest, Transition::Interpolated]);
    let (discount, size) = (random.discount(), random.scale(1e-2, 1e3));
    let costs = Costs {
        step: size,
        rotation: size * random.one_of(&[0.0, 1.0, 10.0]),
        collision: size * random.scale(0.1, 1e5),
        exit: size * random.scale(0.1, 1e5),
        discount,
    };
    let spacing = [random.uniform(0.5, 2.0), random.uniform(0.5, 2.0)];
    let count = 1 + random.below(3);
    let mut region = || -> ppvi::Result<Region> {
        let length = random.scale(0.2, 3.0);
        let stencil = (0..headings).map(|k| {
            [-1.0, 1.0].map(|bevel| {
                let angle = (k as f64 + 0.5 * bevel) * TAU / headings as f64;
                Shift::new([length * angle.cos(), length * angle.sin()], spacing, transition, [nx, ny])
            })
        });
        let stencil = stencil.collect();
        let turn = [kernel(random, -1.0)?, kernel(random, 1.0)?];
        Ok(Region { step_length: length, step_cost: size * length, stencil, turn })
    };
    let regions: Vec<Region> = (0..count).map(|_| region()).collect::<ppvi::Result<_>>()?;
    let mut straight: Vec<Region> = (0..count).map(|_| region()).collect::<ppvi::Result<_>>()?;
    if random.below(3) > 0 {
        straight.clear();
    }
    let region_of = match count {
        1 => Vec::new(),
        _ => (0..4 * nx * ny).map(|_| random.below(count) as u8).collect(),
    };
    let kinds: Vec<u8> = (0..nx * ny)
        .map(|_| match random.below(10) {
            0 => outcome::AT_OBSTACLE,
            1 => outcome::AT_TARGET,
            _ => outcome::CONTINUES,
        })
        .collect();
    let parts = LatticeParts {
        shape,
        spacing,
        transition,
        costs,
        regions: regions.clone(),
        straight: straight.clone(),
        region_of: region_of.clone(),
    };
    let directions = Direction::of_headings(headings, spacing);
    LatticeMdp::new(parts, |motion, k, bevel, codes| {
        let steps = if motion == Motion::Curved { &regions } else { &straight };
        let here = region_of.get(directions[k] as usize * nx * ny..).unwrap_or_default();
        for (at, code) in codes.iter_mut().enumerate() {
            *code = kinds[at];
            if kinds[at] != outcome::CONTINUES {
                continue;
            }
            let Shift { cell, fraction } = steps[here.get(at).map_or(0, |r| usize::from(*r))].stencil[k][bevel];
            let to = [0, 1].map(|axis| {
                let whole = [at / ny, at % ny][axis] as i64 + i64::from(cell[axis]);
                whole + i64::from(fraction[axis] >= 0.5)
            });
            let inside = (0..nx as i64).contains(&to[0]) && (0..ny as i64).contains(&to[1]);
            *code = match inside.then(|| kinds[to[0] as usize * ny + to[1] as usize]) {
                None => outcome::EXIT,
                Some(outcome::AT_OBSTACLE) => outcome::COLLISION,
                Some(outcome::AT_TARGET) => outcome::TARGET,
                Some(_) => outcome::CONTINUES,
            };
        }
    })
}
