//! The paths of all steps of a direction, each once: steps with other actions begin alike, and many branches go on alike.

use crate::space::parts::{SpaceParts, SpaceStep};

/// Voxels relative to the start, in order.
type Path = Vec<[i32; 3]>;

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
    let of_region = |steps: &Vec<SpaceStep>| steps.chunks_exact(parts.actions()).map(of_direction).collect();
    parts.regions.iter().map(of_region).collect()
}

fn of_direction(steps: &[SpaceStep]) -> DirectionPaths {
    let mut found = DirectionPaths::default();
    for step in steps {
        let common = number(&mut found.commons, step.path.clone());
        let rests = step.rests.iter().map(|rest| number(&mut found.rests, (common, rest.clone()))).collect();
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
