//! The paths of all steps of a direction, each once: steps with other actions begin alike, and many branches go on alike.

use crate::space::collision::CollisionGrid;
use crate::space::parts::{SpaceParts, SpaceStep};

/// A voxel relative to the start: the number of its phase, which says which voxel of its grid point it is, and the grid point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PathVoxel {
    pub phase: u32,
    pub point: [i32; 3],
    /// Whether it is within half a spacing of the start along each axis. An execution from a grid point that is not free is not
    /// tested there: this is how it leaves its place.
    pub is_near: bool,
}

impl PathVoxel {
    /// The voxel at an offset from the start.
    pub(crate) fn new(voxels: &CollisionGrid, offset: [i32; 3]) -> Self {
        let (phase, point) = voxels.place(offset);
        let phase = phase.into_iter().fold(0, |number, at| number * voxels.refinement() + at);
        let is_near = offset.iter().all(|at| 2 * at.unsigned_abs() as usize <= voxels.refinement());
        PathVoxel { phase: phase as u32, point, is_near }
    }
}

/// Voxels relative to the start, in order.
type Path = Vec<PathVoxel>;

/// The different paths of the steps of a direction in a region.
#[derive(Default)]
pub(crate) struct DirectionPaths {
    /// Paths with which steps begin.
    pub commons: Vec<Path>,
    /// Paths of branches after them, with the number of the path before each.
    pub rests: Vec<(usize, Path)>,
    /// For each action, the numbers of its paths.
    pub steps: Vec<StepPaths>,
}

/// The paths of a step, by their numbers.
pub(crate) struct StepPaths {
    pub common: usize,
    /// In the order of [`SpaceStep::rests`].
    pub rests: Vec<usize>,
}

/// The paths of all steps, `[region][direction]`.
pub(crate) fn of_parts(parts: &SpaceParts) -> Vec<Vec<DirectionPaths>> {
    let of_region = |steps: &Vec<SpaceStep>| {
        let of_directions = steps.chunks_exact(parts.actions());
        of_directions.map(|steps| of_direction(steps, &parts.voxels)).collect()
    };
    parts.regions.iter().map(of_region).collect()
}

fn of_direction(steps: &[SpaceStep], voxels: &CollisionGrid) -> DirectionPaths {
    let places = |path: &[[i32; 3]]| path.iter().map(|offset| PathVoxel::new(voxels, *offset)).collect::<Path>();
    let mut found = DirectionPaths::default();
    for step in steps {
        let common = number(&mut found.commons, places(&step.path));
        let rests = step.rests.iter().map(|rest| number(&mut found.rests, (common, places(rest)))).collect();
        found.steps.push(StepPaths { common, rests });
    }
    found
}

/// The number of an item, which is added if it is new.
fn number<T: PartialEq>(items: &mut Vec<T>, item: T) -> usize {
    items.iter().position(|known| *known == item).unwrap_or_else(|| {
        items.push(item);
        items.len() - 1
    })
}
