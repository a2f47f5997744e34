//! The problem as an MDP like any other: the definition of what the pass computes.

use std::sync::OnceLock;

use crate::error::Result;
use crate::mdp::Mdp;
use crate::space::collision::voxel;
use crate::space::parts::{Branch, SpaceParts, SpaceShape, SpaceStep};

/// A Markov decision process in a volume; [`crate::space`] has the mathematics.
#[derive(Debug, Clone)]
pub struct SpaceMdp {
    parts: SpaceParts,
    /// Which states are open, found when they are first asked for. A pass finds those of one slice at a time.
    open: OnceLock<Vec<bool>>,
}

impl PartialEq for SpaceMdp {
    fn eq(&self, other: &Self) -> bool {
        self.parts == other.parts
    }
}

impl SpaceMdp {
    /// Validates the parts.
    ///
    /// # Errors
    /// The errors of [`SpaceParts::validate`].
    ///
    /// # Examples
    /// A point that moves one slice at a time, straight ahead, until it meets the target in the last of four slices:
    ///
    /// ```
    /// use ppvi::space::{Branch, CollisionGrid, FailureCosts, PassOptions, SpaceMdp, SpaceParts, SpaceShape, SpaceStep, solve, voxel};
    ///
    /// let step = SpaceStep {
    ///     cost: 2.0,
    ///     length: 1.0,
    ///     path: vec![],
    ///     rests: vec![vec![[1, 0, 0]]],
    ///     branches: vec![Branch { direction: 0, weight: 1.0, rest: 0, cell: [0, 0], fraction: [0.0, 0.0] }],
    ///     lost: 0.0,
    ///     spread: [0.0, 0.0],
    /// };
    /// let mdp = SpaceMdp::new(SpaceParts {
    ///     shape: SpaceShape { slices: 4, ny: 1, nz: 1, directions: 1 },
    ///     advance: 1,
    ///     costs: FailureCosts { collision: 100.0, exit: 100.0 },
    ///     voxels: CollisionGrid::new([4, 1, 1], 1, &[voxel::FREE, voxel::FREE, voxel::FREE, voxel::TARGET])?,
    ///     regions: vec![vec![step]],
    ///     region_of: vec![],
    ///     look: vec![],
    ///     prices: vec![],
    /// })?;
    /// let tables = solve(&mdp, &PassOptions::default(), None)?;
    /// assert_eq!(tables.values[..3], [6.0, 4.0, 2.0]);
    /// # Ok::<(), ppvi::Error>(())
    /// ```
    pub fn new(parts: SpaceParts) -> Result<Self> {
        parts.validate()?;
        Ok(SpaceMdp { parts, open: OnceLock::new() })
    }

    /// What the problem is made of.
    pub fn parts(&self) -> &SpaceParts {
        &self.parts
    }

    /// Shape of the grid.
    pub fn shape(&self) -> SpaceShape {
        self.parts.shape
    }

    /// `(slice, direction, j, k)` of a state number.
    fn coordinates(&self, state: usize) -> [usize; 4] {
        let SpaceShape { ny, nz, directions, .. } = self.parts.shape;
        [state / nz / ny / directions, state / nz / ny % directions, state / nz % ny, state % nz]
    }

    /// Whether a state is open, the slow way.
    fn is_open(&self, state: usize) -> bool {
        self.open.get_or_init(|| self.open_states())[state]
    }

    fn open_states(&self) -> Vec<bool> {
        let SpaceParts { shape, advance, .. } = self.parts;
        let mut open = vec![false; shape.states()];
        for state in (0..shape.states()).rev() {
            let [slice, d, j, k] = self.coordinates(state);
            let is_open = |direction: u32, [dj, dk]: [i32; 2]| {
                shape.point(slice, j, k, [advance as i32, dj, dk]).is_some_and(|point| {
                    let (slice, in_plane) = (point / shape.plane(), point % shape.plane());
                    let state = (slice * shape.directions + direction as usize) * shape.plane() + in_plane;
                    open[state]
                })
            };
            let is_read = |branch: &Branch| {
                let corners = [[0, 0], [0, 1], [1, 0], [1, 1]].into_iter();
                corners.map(|[a, b]| [branch.cell[0] + a, branch.cell[1] + b]).any(|at| is_open(branch.direction, at))
            };
            let at = [slice, d, j, k];
            let leads_on = |action: usize| {
                let step = self.taken(at, action);
                match self.outcome(at, &step.path) {
                    voxel::TARGET => true,
                    voxel::FREE => {
                        step.branches.iter().any(|branch| match self.outcome(at, &step.rests[branch.rest]) {
                            voxel::TARGET => true,
                            voxel::FREE => is_read(branch),
                            _ => false,
                        })
                    }
                    _ => false,
                }
            };
            open[state] = (0..self.parts.actions()).any(leads_on);
        }
        open
    }

    /// The step of an action from a state.
    fn taken(&self, [slice, d, j, k]: [usize; 4], action: usize) -> &SpaceStep {
        self.parts.step(self.parts.region(slice, d, j, k), d, action)
    }

    /// The code of the first voxel of a path that is not free, or that of a free one. From a grid point that is not free, the
    /// voxels within half a spacing of it do not count.
    fn outcome(&self, [slice, _, j, k]: [usize; 4], path: &[[i32; 3]]) -> u8 {
        let voxels = &self.parts.voxels;
        let start = [slice, j, k].map(|at| (at * voxels.refinement()) as i32);
        let leaves = voxels.code(start) != voxel::FREE;
        let is_near = |offset: &[i32; 3]| offset.iter().all(|at| 2 * at.unsigned_abs() as usize <= voxels.refinement());
        let counts = path.iter().filter(|offset| !(leaves && is_near(offset)));
        let code = |offset: &[i32; 3]| voxels.code([0, 1, 2].map(|axis| start[axis] + offset[axis]));
        counts.map(code).find(|code| *code != voxel::FREE).unwrap_or(voxel::FREE)
    }

    /// Calls `visit(outcome, probability, branch)` for the ways in which a step ends: the code of a voxel, or that of a free
    /// one and the branch that has landed.
    fn for_each_outcome(&self, at: [usize; 4], step: &SpaceStep, mut visit: impl FnMut(u8, f64, Option<&Branch>)) {
        match self.outcome(at, &step.path) {
            voxel::FREE if step.branches.is_empty() => visit(voxel::OUTSIDE, 1.0, None),
            voxel::FREE => {
                for branch in &step.branches {
                    match self.outcome(at, &step.rests[branch.rest]) {
                        voxel::FREE => {
                            visit(voxel::OUTSIDE, branch.weight * step.lost, None);
                            visit(voxel::FREE, branch.weight * (1.0 - step.lost), Some(branch));
                        }
                        code => visit(code, branch.weight, None),
                    }
                }
            }
            code => visit(code, 1.0, None),
        }
    }

    /// Calls `visit(point, weight)` for the grid points `(j, k)` among which the landing of a branch is shared, or None beyond the
    /// grid.
    fn for_each_end(&self, [_, _, j, k]: [usize; 4], branch: &Branch, mut visit: impl FnMut(Option<[usize; 2]>, f64)) {
        let SpaceShape { ny, nz, .. } = self.parts.shape;
        let [fj, fk] = branch.fraction;
        for (u, wu) in [(0, 1.0 - fj), (1, fj)] {
            for (v, wv) in [(0, 1.0 - fk), (1, fk)] {
                if wu * wv == 0.0 {
                    continue;
                }
                let corner = [j as i64 + i64::from(branch.cell[0]) + u, k as i64 + i64::from(branch.cell[1]) + v];
                let is_within = (0..ny as i64).contains(&corner[0]) && (0..nz as i64).contains(&corner[1]);
                visit(is_within.then(|| corner.map(|at| at as usize)), wu * wv);
            }
        }
    }
}

impl Mdp for SpaceMdp {
    fn states(&self) -> usize {
        self.parts.shape.states()
    }

    fn discount(&self) -> f64 {
        1.0
    }

    fn actions(&self, state: usize) -> usize {
        if self.is_open(state) { self.parts.actions() } else { 0 }
    }

    fn absorbing_value(&self, _: usize) -> f64 {
        self.parts.costs.exit
    }

    fn stage_cost(&self, state: usize, action: usize) -> f64 {
        let at @ [slice, _, j, k] = self.coordinates(state);
        let SpaceShape { ny, nz, .. } = self.parts.shape;
        let step = self.taken(at, action);
        let mut cost = step.cost + self.parts.price((slice * ny + j) * nz + k) * step.length;
        self.for_each_outcome(at, step, |code, probability, landed| match landed {
            None => cost += probability * self.parts.costs.of(code),
            Some(branch) => self.for_each_end(at, branch, |end, weight| {
                if end.is_none() {
                    cost += probability * weight * self.parts.costs.exit;
                }
            }),
        });
        cost
    }

    fn for_each_successor(&self, state: usize, action: usize, mut visit: impl FnMut(usize, f64)) {
        let at @ [slice, ..] = self.coordinates(state);
        let slice = slice + self.parts.advance;
        self.for_each_outcome(at, self.taken(at, action), |_, probability, landed| {
            let Some(branch) = landed else { return };
            self.for_each_end(at, branch, |end, weight| {
                if let Some([j, k]) = end {
                    visit(self.parts.shape.state(slice, branch.direction as usize, j, k), probability * weight);
                }
            });
        });
    }
}
