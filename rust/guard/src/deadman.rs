//! The deadman switch: the needle moves only while a person holds it.

use crate::{NEVER, Nanoseconds, is_older};

/// The last signal of the switch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Deadman {
    held_ns: Nanoseconds,
}

impl Default for Deadman {
    fn default() -> Deadman {
        Deadman { held_ns: NEVER }
    }
}

impl Deadman {
    /// Note whether the person holds the switch.
    pub fn observe(&mut self, is_held: bool, now_ns: Nanoseconds) {
        self.held_ns = if is_held { now_ns } else { NEVER };
    }

    /// Whether the switch is released, or has been silent for longer than `limit_s`.
    #[must_use]
    pub fn is_released(&self, limit_s: f64, now_ns: Nanoseconds) -> bool {
        is_older(self.held_ns, limit_s, now_ns)
    }
}
