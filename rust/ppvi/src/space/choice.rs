//! The choices of eight neighbouring points, a byte each: the actions.

use crate::space::outcomes::WORD;
use crate::space::reach::LANES;

/// Points of a set, one bit each, among the [`LANES`] numbers of a block from a place on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Group {
    pub place: usize,
    pub set: u8,
}

/// Calls `visit(k, set)` for groups of neighbours with all points of a row, which are bits: the first point, and a bit for each.
pub(crate) fn for_each_group(row: &[u64], mut visit: impl FnMut(usize, u8)) {
    for (word, bits) in row.iter().enumerate() {
        let mut left = *bits;
        while left != 0 {
            let first = left.trailing_zeros();
            visit(word * WORD + first as usize, (left >> first) as u8);
            left &= !(0xff << first);
        }
    }
}

/// Calls `visit(action, set)` for the choices of the points of a set, with those of them that made it.
#[inline]
pub(crate) fn for_each_choice(choices: [u8; LANES], set: u8, mut visit: impl FnMut(u8, u8)) {
    let mut left = set;
    while left != 0 {
        let choice = choices[left.trailing_zeros() as usize];
        let same = left & equal(choices, choice);
        visit(choice, same);
        left ^= same;
    }
}

/// The bytes that are this one, one bit each: eight at a time in a word, which compilers do not find.
#[inline]
fn equal(bytes: [u8; LANES], byte: u8) -> u8 {
    const LOW: u64 = 0x7f7f_7f7f_7f7f_7f7f;
    let differ = u64::from_le_bytes(bytes) ^ u64::from_le_bytes([byte; LANES]);
    let equal = !(((differ & LOW) + LOW) | differ) >> 7 & u64::from_le_bytes([1; LANES]);
    // The product has bit 8 k of the word at bit 56 + k.
    (equal.wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_begin_with_points_and_hold_all() {
        let mut found = Vec::new();
        for_each_group(&[1 | 1 << 7 | 1 << 8 | 3 << 62, 0, 5 << 3], |k, set| found.push((k, set)));
        assert_eq!(found, [(0, 0b1000_0001), (8, 1), (62, 0b11), (131, 0b101)]);
    }

    #[test]
    fn choices_of_a_set_are_those_of_its_points() {
        let mut found = Vec::new();
        for_each_choice([3, 0, 255, 3, 0, 127, 128, 3], 0b0111_1101, |choice, set| found.push((choice, set)));
        assert_eq!(found, [(3, 0b1001), (255, 0b100), (0, 0b1_0000), (127, 0b10_0000), (128, 0b100_0000)]);
        assert_eq!((0..=255).map(|byte| equal([byte; LANES], byte)).min(), Some(255));
    }
}
