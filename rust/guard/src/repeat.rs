//! When a STOP is sent again, and when a heartbeat is due.

use crate::{NEVER, Nanoseconds};

/// Time after which a stop that has reached the stage is sent again (ns).
const AGAIN_NS: Nanoseconds = 20_000_000;
/// Time after which a stop that has not reached the stage is sent again (ns).
const UNSENT_NS: Nanoseconds = 250_000_000;
/// Wait after a slow stop: 10 times the duration of sending it, at most 1 s. Stops then use at most about a tenth of the
/// time of the link, and heartbeats and samples can pass.
const WAIT_FACTOR: Nanoseconds = 10;
const LONGEST_WAIT_NS: Nanoseconds = 1_000_000_000;
/// Shortest time between two heartbeats (ns): less than the period of the loop (5 ms), so that its jitter does not skip
/// every second heartbeat; at most a sixth of the watchdog time of a robot (30 ms).
const HEARTBEAT_NS: Nanoseconds = 4_500_000;

/// Times at which a stop is repeated, and the stops that are on their way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct RepeatedStop {
    arrived_ns: Nanoseconds,
    again_ns: Nanoseconds,
    in_flight: u32,
}

impl Default for RepeatedStop {
    fn default() -> RepeatedStop {
        RepeatedStop { arrived_ns: NEVER, again_ns: 0, in_flight: 0 }
    }
}

impl RepeatedStop {
    /// Time at which the last stop had reached the stage; [`NEVER`] if it has not, or is on its way.
    #[must_use]
    pub fn arrived_ns(&self) -> Nanoseconds {
        self.arrived_ns
    }

    /// Whether a stop is decided and has not been answered, or was not answered.
    #[must_use]
    pub fn is_on_its_way(&self) -> bool {
        self.arrived_ns == NEVER
    }

    /// Note that a stop is about to be sent.
    pub fn begin(&mut self) {
        self.arrived_ns = NEVER;
        self.in_flight = self.in_flight.saturating_add(1);
    }

    /// Note that the stop that was sent at `sent_ns` has arrived or has failed.
    pub fn end(&mut self, sent_ns: Nanoseconds, now_ns: Nanoseconds, has_arrived: bool) {
        self.in_flight = self.in_flight.saturating_sub(1);
        self.arrived_ns = if has_arrived && self.in_flight == 0 { now_ns } else { NEVER };
        let took_ns = now_ns.saturating_sub(sent_ns).saturating_mul(WAIT_FACTOR).min(LONGEST_WAIT_NS);
        self.again_ns = now_ns.saturating_add(took_ns.max(if has_arrived { AGAIN_NS } else { UNSENT_NS }));
    }

    /// Whether the stop may be sent again now; false while a stop is being sent.
    #[must_use]
    pub fn is_due(&self, now_ns: Nanoseconds) -> bool {
        self.in_flight == 0 && now_ns >= self.again_ns
    }
}

/// The time of the last heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Heartbeat {
    /// Time at which the last heartbeat was sent.
    pub sent_ns: Nanoseconds,
}

impl Heartbeat {
    /// Whether a heartbeat is to be sent now; if so, it counts as sent.
    pub fn take(&mut self, now_ns: Nanoseconds) -> bool {
        let is_due = now_ns.saturating_sub(self.sent_ns) >= HEARTBEAT_NS;
        if is_due {
            self.sent_ns = now_ns;
        }
        is_due
    }
}
