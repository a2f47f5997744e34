//! The validation of commands: a command with a value beyond a limit is refused, never clipped.

use crate::cause::{Cause, Causes};

/// Limits of commands. A limit that is not a number refuses every command.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct CommandLimits {
    /// Smallest depth of a command (mm).
    pub shallowest_mm: f64,
    /// Largest depth of a command (mm).
    pub deepest_mm: f64,
    /// Fastest motion inward (mm/s).
    pub insertion_velocity_mm_s: f64,
    /// Fastest motion outward (mm/s).
    pub retraction_velocity_mm_s: f64,
    /// Largest roll to either side (rad).
    pub roll_rad: f64,
    /// Fastest rotation (rad/s).
    pub rotation_velocity_rad_s: f64,
}

impl CommandLimits {
    /// Causes against a motion to a depth, inward or outward, from the last known depth, or an unknown one.
    ///
    /// At an unknown depth, the limit of the speed inward applies.
    #[must_use]
    pub fn against_insertion(&self, here_mm: Option<f64>, depth_mm: f64, velocity_mm_s: f64) -> Causes {
        if !(depth_mm.is_finite() && velocity_mm_s.is_finite()) {
            return Cause::NotFinite.into();
        }
        let is_outward = here_mm.is_some_and(|here_mm| depth_mm <= here_mm);
        let fastest_mm_s = if is_outward { self.retraction_velocity_mm_s } else { self.insertion_velocity_mm_s };
        let is_within = self.shallowest_mm <= depth_mm && depth_mm <= self.deepest_mm;
        unless(is_within, Cause::DepthBeyond) | unless(is_permitted(velocity_mm_s, fastest_mm_s), Cause::VelocityBeyond)
    }

    /// Causes against a retraction by a person; at an unknown depth, only `shallowest_mm` is accepted.
    #[must_use]
    pub fn against_retraction(&self, here_mm: Option<f64>, depth_mm: f64, velocity_mm_s: f64) -> Causes {
        if !(depth_mm.is_finite() && velocity_mm_s.is_finite()) {
            return Cause::NotFinite.into();
        }
        let is_slow = is_permitted(velocity_mm_s, self.retraction_velocity_mm_s);
        unless(depth_mm <= here_mm.unwrap_or(self.shallowest_mm), Cause::NotARetraction)
            | unless(depth_mm >= self.shallowest_mm, Cause::DepthBeyond)
            | unless(is_slow, Cause::VelocityBeyond)
    }

    /// Causes against a rotation of the base to a roll.
    #[must_use]
    pub fn against_rotation(&self, roll_rad: f64, velocity_rad_s: f64) -> Causes {
        if !(roll_rad.is_finite() && velocity_rad_s.is_finite()) {
            return Cause::NotFinite.into();
        }
        let is_slow = is_permitted(velocity_rad_s, self.rotation_velocity_rad_s);
        unless(roll_rad.abs() <= self.roll_rad, Cause::RollBeyond) | unless(is_slow, Cause::RotationBeyond)
    }
}

fn is_permitted(velocity: f64, fastest: f64) -> bool {
    0.0 < velocity && velocity <= fastest
}

fn unless(is_permitted: bool, cause: Cause) -> Causes {
    if is_permitted { Causes::NONE } else { cause.into() }
}
