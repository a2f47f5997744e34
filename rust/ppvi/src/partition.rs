//! Partitions of the state set.
//!
//! A partition assigns a label to every state. The states with one label are its members, in index order. Solvers are
//! correct for any labels; only their speed depends on the choice. Blocks of neighbouring states are a good choice,
//! because most of the transition probability then stays inside a block.

use crate::error::{Error, Result};
use crate::stop::StopFlag;

/// A label for every state, and the members of every label in index order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Partition {
    labels: Vec<u32>,
    offsets: Vec<usize>,
    members: Vec<u32>,
}

impl Partition {
    /// Makes the partitions `0..partitions` from one label per state. A partition may be empty.
    ///
    /// # Errors
    /// [`Error::Parameter`] names the first state whose label is not below `partitions`.
    pub fn from_labels(labels: Vec<u32>, partitions: usize) -> Result<Self> {
        if u32::try_from(labels.len()).is_err() || u32::try_from(partitions).is_err() {
            return Err(Error::parameter("labels", labels.len().max(partitions), "must number less than 2^32"));
        }
        if let Some(state) = labels.iter().position(|&label| label as usize >= partitions) {
            let found = format!("{} at state {state}", labels[state]);
            return Err(Error::parameter("labels", found, "must be less than the number of partitions"));
        }
        let (offsets, members) = group(&labels, 0..labels.len() as u32, partitions);
        Ok(Partition { labels, offsets, members })
    }

    /// Makes one partition that holds every state.
    ///
    /// # Errors
    /// [`Error::Parameter`] for 2^32 states or more.
    pub fn whole(states: usize) -> Result<Self> {
        Self::from_labels(vec![0; states], 1)
    }

    /// Makes a regular grid of `[px, py]` partitions over `[nx, ny]` grid points, as in the thesis.
    ///
    /// `place(state)` returns the grid point of a state. All states of a grid point share a partition. The partition in
    /// column `a` and row `b` has the label `a * py + b`, and the widths of columns differ by at most one point.
    ///
    /// # Errors
    /// [`Error::Parameter`] if the number of partitions along an axis is zero or larger than the number of points, or
    /// if `place` returns a point outside the grid.
    ///
    /// # Examples
    /// ```
    /// use ppvi::Partition;
    ///
    /// // Six states on a row of six points, cut into three partitions.
    /// let partition = Partition::grid(6, [6, 1], [3, 1], |state| [state, 0])?;
    /// assert_eq!(partition.labels(), [0, 0, 1, 1, 2, 2]);
    /// assert_eq!(partition.members(1), [2, 3]);
    /// # Ok::<(), ppvi::Error>(())
    /// ```
    pub fn grid(
        states: usize,
        points: [usize; 2],
        partitions: [usize; 2],
        place: impl Fn(usize) -> [usize; 2],
    ) -> Result<Self> {
        Self::check_grid(points, partitions)?;
        let mut labels = Vec::with_capacity(states);
        let stop = StopFlag::current();
        for state in 0..states {
            stop.check();
            let [i, j] = place(state);
            if i >= points[0] || j >= points[1] {
                return Err(Error::parameter("place", format!("[{i}, {j}] for state {state}"), "must lie on the grid"));
            }
            let (column, row) = (i * partitions[0] / points[0], j * partitions[1] / points[1]);
            labels.push((column * partitions[1] + row) as u32);
        }
        Self::from_labels(labels, partitions[0] * partitions[1])
    }

    /// Checks that a grid of points can be cut into `partitions` along its axes.
    pub(crate) fn check_grid(points: [usize; 2], partitions: [usize; 2]) -> Result<()> {
        if partitions[0] == 0 || partitions[1] == 0 || partitions[0] > points[0] || partitions[1] > points[1] {
            let found = format!("{partitions:?} over {points:?} points");
            return Err(Error::parameter(
                "partitions",
                found,
                "must be between 1 and the number of grid points along each axis",
            ));
        }
        Ok(())
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.labels.len()
    }

    /// Number of partitions, empty ones included.
    pub fn count(&self) -> usize {
        self.offsets.len() - 1
    }

    /// The label of every state.
    pub fn labels(&self) -> &[u32] {
        &self.labels
    }

    /// Members of a partition in index order.
    pub fn members(&self, partition: usize) -> &[u32] {
        &self.members[self.offsets[partition]..self.offsets[partition + 1]]
    }

    /// Checks that the partition has `states` states.
    pub(crate) fn check_states(&self, states: usize) -> Result<()> {
        if self.states() == states {
            return Ok(());
        }
        Err(Error::Length { name: "labels", expected: states, found: self.states() })
    }
}

/// Sorts `values` stably by `keys`, which are less than `groups`. Returns the offsets of the groups `[groups + 1]` and
/// the sorted values.
pub(crate) fn group(keys: &[u32], values: impl Iterator<Item = u32>, groups: usize) -> (Vec<usize>, Vec<u32>) {
    let mut offsets = vec![0; groups + 1];
    for &key in keys {
        offsets[key as usize + 1] += 1;
    }
    for index in 0..groups {
        offsets[index + 1] += offsets[index];
    }
    let mut next = offsets.clone();
    let mut sorted = vec![0; keys.len()];
    for (&key, value) in keys.iter().zip(values) {
        sorted[next[key as usize]] = value;
        next[key as usize] += 1;
    }
    (offsets, sorted)
}
