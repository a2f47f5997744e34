//! The rise of the force within a window of fixed duration and fixed length.

use crate::Nanoseconds;

/// Duration of the window (ns).
pub const WINDOW_NS: Nanoseconds = 50_000_000;

/// Number of samples that the window holds: 50 ms of a force that rises from sample to sample at 10 kHz. The fastest
/// sensor that is supported sends 7 kHz.
pub const CAPACITY: usize = 512;

#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Force {
    time_ns: Nanoseconds,
    force_n: f64,
}

/// Rise of the magnitude of the force above its minimum of the last 50 ms.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct ForceRise {
    /// Forces that may become the minimum, ascending: a ring of `count` entries that begins at `first`.
    forces: [Force; CAPACITY],
    first: usize,
    count: usize,
    rise_n: f64,
    /// Time until which the rise is unknown, because the window was full; `Nanoseconds::MIN` if it is known.
    unknown_until_ns: Nanoseconds,
}

impl Default for ForceRise {
    fn default() -> ForceRise {
        ForceRise::new()
    }
}

impl ForceRise {
    /// A window without samples.
    #[must_use]
    pub const fn new() -> ForceRise {
        let none = Force { time_ns: 0, force_n: 0.0 };
        ForceRise { forces: [none; CAPACITY], first: 0, count: 0, rise_n: 0.0, unknown_until_ns: Nanoseconds::MIN }
    }

    /// Update the rise with the magnitude of the force (N) in a usable sample; one that is not finite is ignored.
    ///
    /// If the window is full, the smallest force of the last 50 ms is lost: the rise is infinite until it is known again.
    pub fn observe(&mut self, time_ns: Nanoseconds, force_n: f64) {
        if !force_n.is_finite() {
            return;
        }
        while self.count > 0 && time_ns.saturating_sub(self.forces[self.place(0)].time_ns) > WINDOW_NS {
            self.first = self.place(1);
            self.count -= 1;
        }
        while self.count > 0 && self.forces[self.place(self.count - 1)].force_n >= force_n {
            self.count -= 1;
        }
        if self.count == CAPACITY {
            self.unknown_until_ns = time_ns.saturating_add(WINDOW_NS);
            self.first = self.place(1);
            self.count -= 1;
        }
        let place = self.place(self.count);
        self.forces[place] = Force { time_ns, force_n };
        self.count += 1;
        let is_known = time_ns > self.unknown_until_ns;
        self.rise_n = if is_known { force_n - self.forces[self.place(0)].force_n } else { f64::INFINITY };
    }

    /// The rise (N); infinite if it is unknown.
    #[must_use]
    pub fn rise_n(&self) -> f64 {
        self.rise_n
    }

    /// Whether the force rises faster than a limit (N/s).
    #[must_use]
    pub fn exceeds(&self, limit_n_s: f64) -> bool {
        let is_within = self.rise_n <= limit_n_s * 0.05; // false for a limit that is not a number
        !is_within
    }

    fn place(&self, number: usize) -> usize {
        self.first.wrapping_add(number) % CAPACITY
    }
}
