//! The states whose values backups can change, by partition, and an in-place sweep over a list of states.

use crate::mdp::Mdp;
use crate::partition::Partition;

/// For every partition, its states that are neither absorbing nor of infinite value, in index order.
#[derive(Debug)]
pub(crate) struct ActiveStates {
    offsets: Vec<usize>,
    states: Vec<u32>,
}

impl ActiveStates {
    pub fn new(mdp: &impl Mdp, partition: &Partition, values: &[f64]) -> Self {
        let (mut offsets, mut states) = (vec![0], Vec::with_capacity(mdp.states()));
        for p in 0..partition.count() {
            let changeable = |s: &u32| mdp.actions(*s as usize) > 0 && values[*s as usize].is_finite();
            states.extend(partition.members(p).iter().copied().filter(changeable));
            offsets.push(states.len());
        }
        ActiveStates { offsets, states }
    }

    pub fn of(&self, partition: usize) -> &[u32] {
        &self.states[self.offsets[partition]..self.offsets[partition + 1]]
    }
}

/// Backs up `states` in place, in their order or in reverse. Returns the smallest and the largest signed change.
pub(crate) fn back_up_in_place(mdp: &impl Mdp, states: &[u32], reverse: bool, values: &mut [f64]) -> (f64, f64) {
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    let mut back_up = |&state: &u32| {
        let new = mdp.backup(state as usize, values).0;
        let change = new - values[state as usize];
        values[state as usize] = new;
        least = least.min(change);
        most = most.max(change);
    };
    if reverse {
        states.iter().rev().for_each(&mut back_up)
    } else {
        states.iter().for_each(&mut back_up)
    }
    (least, most)
}
