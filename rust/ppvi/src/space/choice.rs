//! The choice of a point, a number of 32 bits: region, action, and a code below it. Later choices are larger.

/// Position of the action in a choice; the code of a voxel that is not free is below it.
pub(crate) const ACTION_BITS: u32 = 8;

/// Position of the region in a choice.
const REGION_BITS: u32 = 16;

/// The number of a choice.
pub(crate) fn choice_of([region, action]: [usize; 2]) -> u32 {
    (region as u32) << REGION_BITS | (action as u32) << ACTION_BITS
}

/// Calls `visit([region, action], from, to)` for the runs of points of a row, from one point to another, with the same choice. Ends
/// in voxels are no choices.
pub(crate) fn for_each_run(
    choices: &[u32],
    mut from: usize,
    to: usize,
    mut visit: impl FnMut([usize; 2], usize, usize),
) {
    while from < to {
        let choice = choices[from];
        let end = choices[from..to].iter().position(|other| *other != choice).map_or(to, |count| from + count);
        let [code, action] = [0, ACTION_BITS].map(|bits| choice >> bits & 0xff);
        if code == 0 {
            visit([(choice >> REGION_BITS) as usize, action as usize], from, end);
        }
        from = end;
    }
}

/// The starts, one bit each, that made this choice. `from` is the place of the first bit.
pub(crate) fn of_starts(starts: u64, choice: u32, choices: &[u32], from: usize) -> u64 {
    let mut left = starts;
    let mut found = 0;
    while left != 0 {
        let bit = left & left.wrapping_neg();
        if choices[from + left.trailing_zeros() as usize] == choice {
            found |= bit;
        }
        left ^= bit;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_points_with_the_same_choice_and_no_code() {
        let (a, b) = (choice_of([0, 3]), choice_of([2, 255]));
        let mut found = Vec::new();
        for_each_run(&[b, a, a, b, b | 1, b | 1, b, a, a], 1, 8, |choice, from, to| found.push((choice, from, to)));
        assert_eq!(found, [([0, 3], 1, 3), ([2, 255], 3, 4), ([2, 255], 6, 7), ([0, 3], 7, 8)]);
    }
}
