//! The age of samples: how long ago the device took them, and not how long ago they arrived.

use crate::{NEVER, Nanoseconds, is_older};

/// Largest relative difference between the stated rate of a device clock and the rate of the local clock: two quartz
/// crystals of 50 ppm each.
pub const CLOCK_DRIFT: f64 = 100e-6;

/// Time (ns) by which a sample may be later than the clock, because of rounding and of clocks of processor cores.
const FUTURE_NS: Nanoseconds = 5_000_000;

/// Estimate of the transport delay of samples from a device clock.
///
/// Let sample k be taken at the device time `D_k` and received at the local time `A_k`. Then `A_k - D_k` is the unknown
/// offset of the two clocks plus the delay `w_k >= 0`. The offset changes by at most `r =` [`CLOCK_DRIFT`] of the elapsed
/// time, so `b_k = min(A_k - D_k, b_(k-1) + r (A_k - A_(k-1)))` is at least the offset plus the smallest delay, and
/// `late_s = A_k - D_k - b_k` is at most the delay beyond the smallest one. Therefore:
///
/// - A clock whose drift is at most `r` never causes a delay to be reported: no false alarm, however long the run.
/// - A delay that begins at once is reported in full, less `r` times the time since the fastest sample.
/// - A delay that grows by `c > r` seconds each second exceeds a limit `L` after `L / (c - r)`.
/// - A delay that grows more slowly than `r` is not detected. It amounts to at most 60 ms in ten minutes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Delay {
    /// Delay of the last sample (s).
    pub late_s: f64,
    /// `b_k` (s).
    pub shortest_s: f64,
    /// `A_k` (s).
    pub received_s: f64,
    /// `D_k` (s); not a number before the first sample.
    pub device_s: f64,
}

impl Default for Delay {
    fn default() -> Delay {
        Delay { late_s: 0.0, shortest_s: 0.0, received_s: 0.0, device_s: f64::NAN }
    }
}

impl Delay {
    /// The estimate after another sample. If the device clock goes back, the estimate starts again.
    #[must_use]
    pub fn then(self, received_ns: Nanoseconds, device_s: f64) -> Delay {
        let received_s = received_ns as f64 * 1e-9;
        let transport_s = received_s - device_s;
        let mut shortest_s = transport_s;
        if device_s >= self.device_s {
            let allowed_s = CLOCK_DRIFT * (received_s - self.received_s).max(0.0);
            shortest_s = transport_s.min(self.shortest_s + allowed_s);
        }
        Delay { late_s: transport_s - shortest_s, shortest_s, received_s, device_s }
    }
}

/// Freshness of the samples of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Freshness {
    /// A usable sample was taken within the limit.
    Fresh,
    /// The device has failed since its last usable sample.
    Failed,
    /// No sample was taken within the limit.
    Stale,
    /// Samples are fresh, but none that was taken within the limit is usable.
    Unusable,
}

/// The freshness of a device at a time: `taken_ns` and `usable_ns` are the times at which the device took its last
/// sample and its last usable sample, or [`NEVER`].
#[must_use]
pub fn freshness(
    has_failed: bool,
    taken_ns: Nanoseconds,
    usable_ns: Nanoseconds,
    limit_s: f64,
    now_ns: Nanoseconds,
) -> Freshness {
    if has_failed {
        Freshness::Failed
    } else if is_older(taken_ns, limit_s, now_ns) {
        Freshness::Stale
    } else if is_older(usable_ns, limit_s, now_ns) {
        Freshness::Unusable
    } else {
        Freshness::Fresh
    }
}

/// Whether a sample was received later than the clock permits, so that ages cannot be computed.
#[must_use]
pub fn is_of_the_future(received_ns: Nanoseconds, now_ns: Nanoseconds) -> bool {
    received_ns != NEVER && received_ns.saturating_sub(now_ns) > FUTURE_NS
}
