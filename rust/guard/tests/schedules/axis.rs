//! The axis of a robot that keeps the rules of the protocol.

use needleplan_guard::datagram::Kind;

use crate::events::Mutant;

/// Slots after which the robot stops without a sign of life.
pub const WATCHDOG: i64 = 6;

/// Whether a count is later than another one, as the protocol page says it: by less than half of all numbers.
pub fn after(count: u32, other: u32) -> bool {
    (count.wrapping_sub(other) as i32) > 0
}

/// A robot that obeys the rules of the protocol, and forgets none.
pub struct Axis {
    pub depth_mm: f64,
    pub target_mm: f64,
    pub speed_mm: f64,
    pub sequence: u32,
    pub number: u32,
    pub heard: i64,
    pub moved: i64,
}

impl Axis {
    pub fn is_moving(&self) -> bool {
        self.speed_mm != 0.0
    }

    pub fn receive(&mut self, datagram: &[u8], now: i64, now_ns: i64, mutant: Option<Mutant>) {
        let word = |at: usize| u32::from_le_bytes(datagram[at..at + 4].try_into().unwrap());
        let long = |at: usize| u64::from_le_bytes(datagram[at..at + 8].try_into().unwrap());
        let (kind, sequence, number, deadline_ns) = (datagram[5], word(12), word(36), long(40));
        let is_stop = kind == Kind::Stop as u8;
        if after(sequence, self.sequence) {
            self.sequence = sequence;
            if (deadline_ns >= now_ns as u64 && !is_stop) || (is_stop && !self.is_moving()) {
                self.heard = now;
            }
        }
        if number == 0 || (!after(number, self.number) && mutant != Some(Mutant::OldNumbers)) {
            return;
        }
        self.number = number;
        if is_stop {
            self.speed_mm = 0.0;
        } else if kind == Kind::Insert as u8 && deadline_ns >= now_ns as u64 {
            self.target_mm = f64::from_bits(long(48));
            self.speed_mm = 0.05 * (self.target_mm - self.depth_mm).signum();
        }
    }

    pub fn tick(&mut self, now: i64, mutant: Option<Mutant>) {
        if now - self.heard > WATCHDOG && mutant != Some(Mutant::NoWatchdog) {
            self.speed_mm = 0.0;
        }
        if self.is_moving() {
            self.depth_mm += self.speed_mm;
            self.moved = now;
        }
    }
}
