//! What the branches of a step read of the layer in which they end.

use crate::interpolation::{Order, POINTS, weights};
use crate::space::kernel::{Rows, Term};
use crate::space::layer::Padded;
use crate::space::parts::{Branch, SpaceParts, SpaceStep};

/// What a branch reads of the layer in which it ends.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Footprint {
    /// Place of the first point relative to the start in the plane of the first direction.
    first: i64,
    /// Weights along y, times the probability of reaching the landing in a direction of the grid.
    of_y: [f32; POINTS],
    /// Probability.
    pub weight: f32,
    /// Number of its path.
    pub rest: u32,
}

impl Footprint {
    /// The field where the branch lands, interpolated with P points, times the probability of that.
    #[inline(always)]
    pub(crate) fn landing<const P: usize>(
        &self,
        of_z: &[f32; POINTS],
        field: &[f32],
        start: usize,
        width: usize,
    ) -> f32 {
        let skipped = (POINTS - P) / 2;
        let first = (start as i64 + self.first) as usize + skipped * (width + 1);
        let mut sums = [0.0; P];
        for y in 0..P {
            let row = &field[first + y * width..][..P];
            for z in 0..P {
                sums[z] += self.of_y[skipped + y] * row[z];
            }
        }
        sums.iter().zip(&of_z[skipped..]).map(|(sum, by)| sum * by).sum()
    }

    /// Adds the rows that the branch reads.
    #[inline]
    fn terms(&self, width: usize, terms: &mut Vec<Term>) {
        for (point, by) in self.of_y.into_iter().enumerate().filter(|(_, by)| *by != 0.0) {
            terms.push(Term { first: self.first + (point * width) as i64, by });
        }
    }
}

/// A column of the grid in which branches land: they share the weights along z.
#[derive(Debug, Clone, Copy)]
struct Column {
    branches: u32,
    of_z: [f32; POINTS],
}

/// What a step reads: its columns, and the branches of one after another.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StepReads<'a> {
    columns: &'a [Column],
    branches: &'a [Footprint],
}

impl<'a> StepReads<'a> {
    /// Lists the rows that the step reads.
    pub(crate) fn list_rows(self, width: usize, rows: &mut Rows) {
        rows.terms.clear();
        rows.columns.clear();
        for (branches, of_z) in self.columns() {
            branches.iter().for_each(|branch| branch.terms(width, &mut rows.terms));
            rows.columns.push((rows.terms.len(), *of_z));
        }
    }

    /// The columns: branches, and weights along z.
    #[inline]
    pub(crate) fn columns(self) -> impl Iterator<Item = (&'a [Footprint], &'a [f32; POINTS])> {
        let mut left = self.branches;
        self.columns.iter().map(move |column| {
            let (branches, others) = left.split_at(column.branches as usize);
            left = others;
            (branches, &column.of_z)
        })
    }
}

/// What all steps read, for one interpolation. All of it lies in the order of the pass, since it is read anew for each slice.
pub(crate) struct Footprints {
    columns: Vec<Column>,
    branches: Vec<Footprint>,
    /// For each step, `[region][direction][action]`, its first column and its first branch; and the ends.
    first: Vec<[u32; 2]>,
    directions: usize,
    actions: usize,
}

impl Footprints {
    /// Finds what all steps read.
    pub(crate) fn new(parts: &SpaceParts, padded: Padded, order: Order) -> Self {
        let (directions, actions) = (parts.shape.directions, parts.actions());
        let mut found = Footprints { columns: vec![], branches: vec![], first: vec![[0; 2]], directions, actions };
        for step in parts.regions.iter().flatten() {
            for branches in step.branches.chunk_by(|a, b| (a.cell[1], a.fraction[1]) == (b.cell[1], b.fraction[1])) {
                let of_z = weights(order, branches[0].fraction[1], step.spread[1]).map(|of_z| of_z as f32);
                found.columns.push(Column { branches: branches.len() as u32, of_z });
                found.branches.extend(branches.iter().map(|branch| footprint(step, branch, padded, order)));
            }
            found.first.push([found.columns.len() as u32, found.branches.len() as u32]);
        }
        found
    }

    /// What a step reads.
    #[inline]
    pub(crate) fn of(&self, [region, direction, action]: [usize; 3]) -> StepReads<'_> {
        let step = (region * self.directions + direction) * self.actions + action;
        let ([columns, branches], [end_columns, end_branches]) = (self.first[step], self.first[step + 1]);
        StepReads {
            columns: &self.columns[columns as usize..end_columns as usize],
            branches: &self.branches[branches as usize..end_branches as usize],
        }
    }
}

fn footprint(step: &SpaceStep, branch: &Branch, padded: Padded, order: Order) -> Footprint {
    let ([y, z], probability) = (padded.within(branch.cell), branch.weight * (1.0 - step.lost));
    Footprint {
        first: i64::from(branch.direction) * padded.len() as i64 + (y - 1) * padded.width as i64 + z - 1,
        of_y: weights(order, branch.fraction[0], step.spread[0]).map(|of_y| of_y as f32 * probability as f32),
        weight: branch.weight as f32,
        rest: branch.rest as u32,
    }
}
