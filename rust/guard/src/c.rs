//! The functions of `include/needleplan_guard.h`. Values go in and out by copy; only `guard_force_rise` is passed by
//! reference. A number that is not one of an enumeration is an error of the caller, and stops the needle.
#![allow(unsafe_code, reason = "names of C functions must be exported unmangled")]

use crate::Nanoseconds;
use crate::advance::{ordered, validated};
use crate::age::{Delay, freshness, is_of_the_future};
use crate::cause::{Cause, Causes, Owner};
use crate::command::CommandLimits;
use crate::deadman::Deadman;
use crate::repeat::{Heartbeat, RepeatedStop};
use crate::rise::ForceRise;
use crate::state::{Motion, Operating, Order, Report, State, Transition};

/// An owner by its number; this number stands for none.
const NONE: u8 = 255;

/// `guard_state`: the fields of [`State`].
#[derive(Clone, Copy)]
#[repr(C)]
pub struct CState {
    present: u64,
    latched: u64,
    first: u64,
    since_ns: Nanoseconds,
    operating: u8,
    held_by: u8,
    motion: u8,
    waits: u8,
    is_homed: u8,
    is_busy: u8,
    is_zero_lost: u8,
    is_stopping: u8,
}

/// `guard_report`: the fields of [`Report`].
#[derive(Clone, Copy)]
#[repr(C)]
pub struct CReport {
    causes: u64,
    is_busy: u8,
    is_retracting: u8,
    is_resting: u8,
}

/// `guard_transition`: the fields of [`Transition`].
#[repr(C)]
pub struct CTransition {
    state: CState,
    causes: u64,
    stops: u8,
    moves: u8,
    retracts: u8,
    is_refused: u8,
}

fn number(owner: Option<Owner>) -> u8 {
    owner.map_or(NONE, |owner| owner as u8)
}

fn owner(number: u8) -> Option<Option<Owner>> {
    if number == NONE { Some(None) } else { Owner::ALL.get(usize::from(number)).copied().map(Some) }
}

impl From<State> for CState {
    fn from(state: State) -> CState {
        CState {
            present: state.present.0,
            latched: state.latched.0,
            first: state.first.0,
            since_ns: state.since_ns,
            operating: state.operating as u8,
            held_by: number(state.held_by),
            motion: number(state.motion),
            waits: number(state.waits),
            is_homed: state.is_homed.into(),
            is_busy: state.is_busy.into(),
            is_zero_lost: state.is_zero_lost.into(),
            is_stopping: state.is_stopping.into(),
        }
    }
}

impl CState {
    fn checked(self) -> Option<State> {
        Some(State {
            operating: Operating::ALL.get(usize::from(self.operating)).copied()?,
            is_homed: self.is_homed != 0,
            is_busy: self.is_busy != 0,
            present: Causes(self.present),
            latched: Causes(self.latched),
            since_ns: self.since_ns,
            held_by: owner(self.held_by)?,
            motion: owner(self.motion)?,
            is_zero_lost: self.is_zero_lost != 0,
            first: Causes(self.first),
            is_stopping: self.is_stopping != 0,
            waits: owner(self.waits)?,
        })
    }
}

impl From<Transition> for CTransition {
    fn from(transition: Transition) -> CTransition {
        CTransition {
            state: transition.state.into(),
            causes: transition.causes.0,
            stops: transition.stops.into(),
            moves: (transition.motion == Some(Motion::Move)).into(),
            retracts: (transition.motion == Some(Motion::Retract)).into(),
            is_refused: transition.is_refused.into(),
        }
    }
}

/// The transition for a state that cannot be: a stop, and the fault `guard_failed`; the zero counts as lost.
fn failed(now_ns: Nanoseconds) -> CTransition {
    let paused = State { operating: Operating::Paused, is_zero_lost: true, ..State::default() };
    validated(paused, Report { causes: Cause::GuardFailed.into(), ..Report::default() }, now_ns).into()
}

/// The state before the first event.
#[unsafe(no_mangle)]
pub extern "C" fn guard_begin(now_ns: Nanoseconds) -> CState {
    State { since_ns: now_ns, ..State::default() }.into()
}

/// See [`ordered`]; an unknown order or owner is refused.
#[unsafe(no_mangle)]
pub extern "C" fn guard_order(state: CState, order: u8, owner: u8, now_ns: Nanoseconds) -> CTransition {
    let Some(state) = state.checked() else { return failed(now_ns) };
    match (Order::ALL.get(usize::from(order)), Owner::ALL.get(usize::from(owner))) {
        (Some(order), Some(owner)) => ordered(state, *order, *owner, now_ns).into(),
        _ => Transition { causes: Cause::NotPossible.into(), is_refused: true, ..state.into() }.into(),
    }
}

/// See [`validated`]; a cause that is not known counts as `guard_failed`.
#[unsafe(no_mangle)]
pub extern "C" fn guard_validate(state: CState, report: CReport, now_ns: Nanoseconds) -> CTransition {
    let Some(state) = state.checked() else { return failed(now_ns) };
    let (given, known) = (Causes(report.causes), Causes(report.causes) & Causes::ALL);
    let causes = if given == known { known } else { known | Cause::GuardFailed.into() };
    let report = Report {
        causes,
        is_busy: report.is_busy != 0,
        is_retracting: report.is_retracting != 0,
        is_resting: report.is_resting != 0,
    };
    validated(state, report, now_ns).into()
}

fn known(depth_mm: f64) -> Option<f64> {
    (!depth_mm.is_nan()).then_some(depth_mm)
}

/// See [`CommandLimits::against_insertion`]; NaN for an unknown depth.
#[unsafe(no_mangle)]
pub extern "C" fn guard_against_insertion(
    limits: CommandLimits,
    here_mm: f64,
    depth_mm: f64,
    velocity_mm_s: f64,
) -> u64 {
    limits.against_insertion(known(here_mm), depth_mm, velocity_mm_s).0
}

/// See [`CommandLimits::against_retraction`]; NaN for an unknown depth.
#[unsafe(no_mangle)]
pub extern "C" fn guard_against_retraction(
    limits: CommandLimits,
    here_mm: f64,
    depth_mm: f64,
    velocity_mm_s: f64,
) -> u64 {
    limits.against_retraction(known(here_mm), depth_mm, velocity_mm_s).0
}

/// See [`CommandLimits::against_rotation`].
#[unsafe(no_mangle)]
pub extern "C" fn guard_against_rotation(limits: CommandLimits, roll_rad: f64, velocity_rad_s: f64) -> u64 {
    limits.against_rotation(roll_rad, velocity_rad_s).0
}

/// The delay before the first sample.
#[unsafe(no_mangle)]
pub extern "C" fn guard_delay_begin() -> Delay {
    Delay::default()
}

/// See [`Delay::then`].
#[unsafe(no_mangle)]
pub extern "C" fn guard_delay_then(delay: Delay, received_ns: Nanoseconds, device_s: f64) -> Delay {
    delay.then(received_ns, device_s)
}

/// See [`freshness`].
#[unsafe(no_mangle)]
pub extern "C" fn guard_freshness(
    has_failed: u8,
    taken_ns: Nanoseconds,
    usable_ns: Nanoseconds,
    limit_s: f64,
    now_ns: Nanoseconds,
) -> u8 {
    freshness(has_failed != 0, taken_ns, usable_ns, limit_s, now_ns) as u8
}

/// See [`is_of_the_future`].
#[unsafe(no_mangle)]
pub extern "C" fn guard_is_of_the_future(received_ns: Nanoseconds, now_ns: Nanoseconds) -> u8 {
    is_of_the_future(received_ns, now_ns).into()
}

/// Number of bytes of a `guard_force_rise`, for the size of the memory that C provides.
#[unsafe(no_mangle)]
pub extern "C" fn guard_force_rise_size() -> usize {
    size_of::<ForceRise>()
}

/// Write a window without samples; NULL is ignored.
#[unsafe(no_mangle)]
pub extern "C" fn guard_force_rise_begin(rise: Option<&mut core::mem::MaybeUninit<ForceRise>>) {
    if let Some(rise) = rise {
        rise.write(ForceRise::new());
    }
}

/// See [`ForceRise::observe`]; NULL is ignored.
#[unsafe(no_mangle)]
pub extern "C" fn guard_force_rise_observe(rise: Option<&mut ForceRise>, time_ns: Nanoseconds, force_n: f64) {
    if let Some(rise) = rise {
        rise.observe(time_ns, force_n);
    }
}

/// See [`ForceRise::exceeds`]; true for NULL.
#[unsafe(no_mangle)]
pub extern "C" fn guard_force_rise_exceeds(rise: Option<&ForceRise>, limit_n_s: f64) -> u8 {
    rise.is_none_or(|rise| rise.exceeds(limit_n_s)).into()
}

/// The times before the first stop.
#[unsafe(no_mangle)]
pub extern "C" fn guard_stop_none() -> RepeatedStop {
    RepeatedStop::default()
}

/// See [`RepeatedStop::begin`].
#[unsafe(no_mangle)]
pub extern "C" fn guard_stop_begin(mut stop: RepeatedStop) -> RepeatedStop {
    stop.begin();
    stop
}

/// See [`RepeatedStop::end`].
#[unsafe(no_mangle)]
pub extern "C" fn guard_stop_end(
    mut stop: RepeatedStop,
    sent_ns: Nanoseconds,
    now_ns: Nanoseconds,
    has_arrived: u8,
) -> RepeatedStop {
    stop.end(sent_ns, now_ns, has_arrived != 0);
    stop
}

/// See [`RepeatedStop::is_due`].
#[unsafe(no_mangle)]
pub extern "C" fn guard_stop_is_due(stop: RepeatedStop, now_ns: Nanoseconds) -> u8 {
    stop.is_due(now_ns).into()
}

/// See [`RepeatedStop::is_on_its_way`].
#[unsafe(no_mangle)]
pub extern "C" fn guard_stop_is_on_its_way(stop: RepeatedStop) -> u8 {
    stop.is_on_its_way().into()
}

/// See [`Heartbeat::take`]: whether a heartbeat is due that follows the one at `sent_ns`.
#[unsafe(no_mangle)]
pub extern "C" fn guard_heartbeat_is_due(sent_ns: Nanoseconds, now_ns: Nanoseconds) -> u8 {
    Heartbeat { sent_ns }.take(now_ns).into()
}

/// The switch before its first signal.
#[unsafe(no_mangle)]
pub extern "C" fn guard_deadman_begin() -> Deadman {
    Deadman::default()
}

/// See [`Deadman::observe`].
#[unsafe(no_mangle)]
pub extern "C" fn guard_deadman_observe(mut deadman: Deadman, is_held: u8, now_ns: Nanoseconds) -> Deadman {
    deadman.observe(is_held != 0, now_ns);
    deadman
}

/// See [`Deadman::is_released`].
#[unsafe(no_mangle)]
pub extern "C" fn guard_deadman_is_released(deadman: Deadman, limit_s: f64, now_ns: Nanoseconds) -> u8 {
    deadman.is_released(limit_s, now_ns).into()
}
