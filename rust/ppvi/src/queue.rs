//! A max-queue of indices with changeable keys.

/// Binary heap over the indices `0..capacity`, each queued at most once, with the position of every index at hand: a
/// key changes in O(log n). Equal keys leave in order of rising index, so the order of a solve is reproducible.
#[derive(Debug, Clone)]
pub struct IndexedMaxQueue {
    heap: Vec<u32>,
    positions: Vec<u32>,
    keys: Vec<f64>,
}

const ABSENT: u32 = u32::MAX;

impl IndexedMaxQueue {
    /// An empty queue for the indices `0..capacity`; the other methods panic on an index beyond.
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

    /// Takes `index` out; without effect if it is not queued.
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

    /// The index with the largest key, left in the queue.
    pub fn peek(&self) -> Option<(usize, f64)> {
        let &index = self.heap.first()?;
        Some((index as usize, self.keys[index as usize]))
    }

    /// Takes out the index with the largest key.
    pub fn pop(&mut self) -> Option<(usize, f64)> {
        let (index, key) = self.peek()?;
        self.remove(index);
        Some((index, key))
    }

    /// The index with the smallest key; equal keys: the lowest index. Looks at every queued index.
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

    /// Puts `index` at `position`, whose occupant may be overwritten, and moves it up or down to where it belongs.
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
