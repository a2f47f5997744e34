//! A priority queue of indices with changeable keys.

/// A binary max-heap over the indices `0..capacity`, each queued at most once.
///
/// The queue stores the position of every index, so a key changes in O(log n). Of equal keys the lowest index leaves
/// first, so the order of a solve is reproducible.
///
/// # Examples
/// ```
/// use ppvi::queue::IndexedMaxQueue;
///
/// let mut queue = IndexedMaxQueue::new(3);
/// (0..3).for_each(|index| queue.set(index, index as f64));
/// queue.set(0, 5.0);
/// assert_eq!(queue.pop(), Some((0, 5.0)));
/// assert_eq!(queue.peek(), Some((2, 2.0)));
/// ```
#[derive(Debug, Clone)]
pub struct IndexedMaxQueue {
    heap: Vec<u32>,
    positions: Vec<u32>,
    keys: Vec<f64>,
}

/// Position of an index that is not queued.
const ABSENT: u32 = u32::MAX;

impl IndexedMaxQueue {
    /// Makes an empty queue for the indices `0..capacity`. The other methods panic if an index is not below `capacity`.
    pub fn new(capacity: usize) -> Self {
        IndexedMaxQueue { heap: Vec::new(), positions: vec![ABSENT; capacity], keys: vec![0.0; capacity] }
    }

    /// Number of queued indices.
    pub fn len(&self) -> usize {
        self.heap.len()
    }

    /// Whether nothing is queued.
    pub fn is_empty(&self) -> bool {
        self.heap.is_empty()
    }

    /// The key of `index`, if it is queued.
    pub fn key(&self, index: usize) -> Option<f64> {
        (self.positions[index] != ABSENT).then(|| self.keys[index])
    }

    /// Queues `index`, or changes its key if it is queued already.
    pub fn set(&mut self, index: usize, key: f64) {
        self.keys[index] = key;
        let position = match self.positions[index] {
            ABSENT => {
                self.heap.push(index as u32);
                self.heap.len() - 1
            }
            position => position as usize,
        };
        self.restore(position, index as u32);
    }

    /// Removes `index`, if it is queued.
    pub fn remove(&mut self, index: usize) {
        let position = std::mem::replace(&mut self.positions[index], ABSENT);
        if position == ABSENT {
            return;
        }
        if let Some(last) = self.heap.pop()
            && last != index as u32
        {
            self.restore(position as usize, last);
        }
    }

    /// Returns the index with the largest key and the key. The index stays in the queue.
    pub fn peek(&self) -> Option<(usize, f64)> {
        let &index = self.heap.first()?;
        Some((index as usize, self.keys[index as usize]))
    }

    /// Removes and returns the index with the largest key, and the key.
    pub fn pop(&mut self) -> Option<(usize, f64)> {
        let (index, key) = self.peek()?;
        self.remove(index);
        Some((index, key))
    }

    /// The index with the smallest key, of equal keys the lowest index. Takes time O(n).
    pub fn least(&self) -> Option<usize> {
        let key = |index: &u32| self.keys[*index as usize];
        self.heap.iter().copied().min_by(|a, b| key(a).total_cmp(&key(b)).then(a.cmp(b))).map(|index| index as usize)
    }

    fn before(&self, left: u32, right: u32) -> bool {
        self.keys[left as usize].total_cmp(&self.keys[right as usize]).then(right.cmp(&left)).is_gt()
    }

    fn place(&mut self, position: usize, index: u32) {
        self.heap[position] = index;
        self.positions[index as usize] = position as u32;
    }

    /// Writes `index` at `position`, over the index there, and moves it up or down until the heap is ordered.
    fn restore(&mut self, mut position: usize, index: u32) {
        while position > 0 && self.before(index, self.heap[(position - 1) / 2]) {
            self.place(position, self.heap[(position - 1) / 2]);
            position = (position - 1) / 2;
        }
        loop {
            let mut child = 2 * position + 1;
            if child >= self.heap.len() {
                break;
            }
            if child + 1 < self.heap.len() && self.before(self.heap[child + 1], self.heap[child]) {
                child += 1;
            }
            if !self.before(self.heap[child], index) {
                break;
            }
            self.place(position, self.heap[child]);
            position = child;
        }
        self.place(position, index);
    }
}
