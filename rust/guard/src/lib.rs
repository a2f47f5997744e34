//! The safety guard: what is decided between a sample of a device and a STOP of the robot.
//!
//! The crate needs neither `std` nor an allocator, reads no clock, and keeps nothing between calls but the values that
//! its caller holds. Times are in ns of one monotonic clock, [`NEVER`] where there is none. Units: mm, N, s, rad.
//!
//! | module | decides |
//! |---|---|
//! | [`advance`] | the next operating state after an order or a validation, and whether to stop |
//! | [`command`] | whether a command is within the limits |
//! | [`age`] | whether the samples of a device are fresh |
//! | [`rise`] | whether the force rises too fast |
//! | [`repeat`] | when a STOP is sent again, and when a heartbeat is due |
//! | [`deadman`] | whether a person holds the deadman switch |
//! | `supervisor` | what is sent to a robot, with and without the program |
//! | `session` | what its datagrams mean |
//! | `datagram`, `hmac` | their bytes |
//! | `line` | the frames of a serial line, and which datagram leaves next |
//!
//! The feature `robot`, which is on by default, adds the last five; the feature `c` adds the functions of
//! `include/needleplan_guard.h`.
#![no_std]
#![cfg_attr(not(feature = "c"), forbid(unsafe_code))]
#![deny(unsafe_code)]

pub mod advance;
pub mod age;
#[cfg(feature = "c")]
mod c;
pub mod cause;
pub mod command;
#[cfg(feature = "robot")]
pub mod datagram;
pub mod deadman;
#[cfg(feature = "robot")]
pub mod hmac;
#[cfg(feature = "robot")]
pub mod line;
pub mod repeat;
pub mod rise;
#[cfg(feature = "robot")]
pub mod session;
pub mod state;
#[cfg(feature = "robot")]
pub mod supervisor;

/// Times in ns of one monotonic clock.
pub type Nanoseconds = i64;

/// The time of what has not happened.
pub const NEVER: Nanoseconds = Nanoseconds::MIN;

/// Whether a moment is [`NEVER`] or longer ago than `limit_s`.
#[must_use]
pub fn is_older(moment_ns: Nanoseconds, limit_s: f64, now_ns: Nanoseconds) -> bool {
    let is_young = now_ns.saturating_sub(moment_ns) as f64 <= limit_s * 1e9; // false for a limit that is not a number
    moment_ns == NEVER || !is_young
}
