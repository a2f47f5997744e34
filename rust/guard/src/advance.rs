//! The transitions of the guard: pure functions from one state and one event to the next state.
//!
//! In ENABLED the needle follows the loop; in all other states only a person can move the needle, by a retraction. In
//! PAUSED the needle waits for the order RESUME. In FAULT a fault is present. The rules:
//!
//! 1. Orders neither cause nor end FAULT. When no fault is present, FAULT becomes DISABLED.
//! 2. ENABLED is entered only by ENABLE from DISABLED and by RESUME from PAUSED, and only while no cause is present, no
//!    retraction is in force, and the needle was measured at rest after the last stop. An earlier ENABLE or RESUME waits
//!    for this rest; a cause, and every order that stops the needle, ends the wait.
//! 3. Only a person ends what a person ordered: ENABLE and RESUME by the loop are refused while a person holds the
//!    needle. The loop may end a pause that a cause began, when the cause is gone.
//! 4. Faults and ordered stops are latched: ENABLE is refused until RESET. Only a person may give RESET, and RESET is
//!    refused in FAULT. After `stage_jumped` and after UNHOME by a person, only a person may give HOME.
//! 5. In DISABLED a cause only prevents enabling. The exceptions are `still_moving` and the causes that stop a
//!    retraction, which lead to FAULT.
//! 6. A retraction is a motion of a person. Every STOP, DISABLE and PAUSE by a person stops it; of the causes, only
//!    `wrong_way` and `stage_jumped` do. The loop cannot stop it: STOP and DISABLE by the loop disable the guard and
//!    leave the retraction in force.
//! 7. Every transition out of ENABLED, and the end of a retraction, stops the needle. The interrupted command is not
//!    continued later.

use crate::Nanoseconds;
use crate::cause::{Cause, Causes, Owner};
use crate::state::{Motion, Operating, Order, Report, State, Transition};

/// Causes that stop the stage again in FAULT, because they show that the stage moves in spite of the first stop.
const OF_MOTION: Causes = Causes::of(&[
    Cause::StillMoving,
    Cause::WrongWay,
    Cause::Overspeed,
    Cause::DepthExceeded,
    Cause::RollExceeded,
    Cause::StageJumped,
]);
/// Causes that lead to FAULT even from DISABLED.
const FAULTS_WHEN_DISABLED: Causes = Causes::of(&[Cause::StillMoving]);
/// Causes that stop a retraction by a person.
const ENDS_RETRACTION: Causes = Causes::of(&[Cause::WrongWay, Cause::StageJumped]);
/// Causes after which the stage must be homed again.
const ZERO_LOST: Causes = Causes::of(&[Cause::StageJumped]);

/// The transition that a validation of all inputs causes.
#[must_use]
pub fn validated(before: State, report: Report, now_ns: Nanoseconds) -> Transition {
    let is_retracting = before.is_retracting() && report.is_retracting;
    let has_rested = before.is_stopping && report.is_resting;
    let has_ended = before.is_retracting() && !is_retracting;
    let is_healthy = report.causes.is_empty() && before.present.is_empty() && before.operating != Operating::Fault;
    if is_healthy && report.is_busy == before.is_busy && !has_rested && !has_ended {
        return before.into();
    }
    let present = report.causes - Causes::REFUSALS;
    let mut faults = present & Causes::FAULTS;
    let waits = if present.is_empty() { before.waits } else { None };
    let is_stopping = before.is_stopping && !has_rested;
    let mut state = State { present, is_busy: report.is_busy, waits, is_stopping, ..before };
    if present.meets(ZERO_LOST) {
        state = State { is_homed: false, is_zero_lost: true, ..state };
    }
    if state.operating == Operating::Fault {
        if faults.is_empty() {
            return stopped_if(has_ended, to(state, Operating::Disabled, now_ns), Causes::NONE);
        }
        let new = faults - before.present;
        let is_new = new.meets(if is_retracting { ENDS_RETRACTION } else { OF_MOTION });
        return stopped_if(is_new || has_ended, latched(state, faults), new);
    }
    if state.operating == Operating::Disabled {
        faults = faults & (FAULTS_WHEN_DISABLED | if is_retracting { ENDS_RETRACTION } else { Causes::NONE });
    }
    if !faults.is_empty() {
        let state = held(latched(State { first: faults, ..state }, faults), faults.first_owner());
        let stops = !is_retracting || faults.meets(ENDS_RETRACTION);
        return stopped_if(stops, to(state, Operating::Fault, now_ns), faults);
    }
    if state.operating == Operating::Enabled && !present.is_empty() {
        let paused = to(State { first: present, ..state }, Operating::Paused, now_ns);
        return stopped(held(paused, present.first_owner()), present);
    }
    if waits.is_some() && !state.is_stopping {
        return enabled(state, now_ns).into();
    }
    stopped_if(has_ended, state, Causes::NONE)
}

/// The transition that an order of an owner causes.
#[must_use]
pub fn ordered(state: State, order: Order, owner: Owner, now_ns: Nanoseconds) -> Transition {
    match order {
        Order::Enable => enable(state, owner, now_ns),
        Order::Disable => disable(state, owner, now_ns),
        Order::Pause => pause(state, owner, now_ns),
        Order::Resume => resume(state, owner, now_ns),
        Order::Reset => reset(state, owner),
        Order::Stop => stop(state, owner, now_ns),
        Order::Home => home(state, owner),
        Order::Unhome => unhome(state, owner),
        Order::Move => move_on(state, owner),
        Order::Retract => retract(state, owner, now_ns),
    }
}

fn enable(state: State, owner: Owner, now_ns: Nanoseconds) -> Transition {
    if state.operating == Operating::Enabled {
        return state.into();
    }
    if state.operating != Operating::Disabled {
        return refused(state, state.present | Cause::NotPossible.into());
    }
    let mut against = state.present;
    if !state.latched.is_empty() {
        against |= state.latched | Cause::NotReset.into();
    }
    if !state.is_homed {
        against |= Cause::NotHomed.into();
    }
    begun(state, owner, against, now_ns)
}

fn resume(state: State, owner: Owner, now_ns: Nanoseconds) -> Transition {
    if state.operating != Operating::Paused {
        return refused(state, Cause::NotPossible.into());
    }
    begun(state, owner, state.present, now_ns)
}

fn begun(state: State, owner: Owner, mut against: Causes, now_ns: Nanoseconds) -> Transition {
    if !may_begin(&state, owner) {
        against |= Cause::NotAuthorized.into();
    }
    if state.is_retracting() {
        against |= Cause::NotPossible.into();
    }
    if !against.is_empty() {
        return refused(state, against);
    }
    if state.is_stopping { State { waits: Some(owner), ..state }.into() } else { enabled(state, now_ns).into() }
}

fn enabled(state: State, now_ns: Nanoseconds) -> State {
    let state = to(state, Operating::Enabled, now_ns);
    State { held_by: None, first: Causes::NONE, waits: None, ..state }
}

/// Whether `owner` may end the present hold. A fault can be ended only by RESET, so a pause is meant here.
fn may_begin(state: &State, owner: Owner) -> bool {
    match owner {
        Owner::Person => true,
        Owner::Loop if state.operating == Operating::Disabled => matches!(state.held_by, None | Some(Owner::Loop)),
        Owner::Loop => matches!(state.held_by, Some(Owner::Robot | Owner::Sensor | Owner::Loop)),
        Owner::Robot | Owner::Sensor => false,
    }
}

fn disable(state: State, owner: Owner, now_ns: Nanoseconds) -> Transition {
    // The order does not end FAULT, but the stop is sent again.
    let is_fault = state.operating == Operating::Fault;
    let state = if is_fault { state } else { to(state, Operating::Disabled, now_ns) };
    stopped_by(owner, held(state, Some(owner)), Causes::NONE)
}

fn stop(mut state: State, owner: Owner, now_ns: Nanoseconds) -> Transition {
    let cause = Causes::from(Cause::StopOrdered);
    if matches!(state.operating, Operating::Enabled | Operating::Paused) {
        state = State { first: cause, ..to(state, Operating::Disabled, now_ns) };
    }
    stopped_by(owner, latched(held(state, Some(owner)), cause), cause)
}

fn pause(state: State, owner: Owner, now_ns: Nanoseconds) -> Transition {
    if !matches!(state.operating, Operating::Enabled | Operating::Paused) {
        return refused(state, Cause::NotPossible.into());
    }
    stopped_by(owner, held(to(state, Operating::Paused, now_ns), Some(owner)), Causes::NONE)
}

fn reset(state: State, owner: Owner) -> Transition {
    if owner != Owner::Person {
        return refused(state, Cause::NotAuthorized.into());
    }
    if state.operating == Operating::Fault {
        return refused(state, state.present | Cause::NotPossible.into());
    }
    let is_free = state.operating == Operating::Disabled && state.held_by != Some(Owner::Person);
    let held_by = if is_free { None } else { state.held_by };
    State { latched: Causes::NONE, first: Causes::NONE, held_by, ..state }.into()
}

fn home(state: State, owner: Owner) -> Transition {
    if owner != Owner::Person && (owner != Owner::Loop || state.is_zero_lost) {
        return refused(state, Cause::NotAuthorized.into());
    }
    let lost = state.present & ZERO_LOST;
    if state.operating != Operating::Disabled || !lost.is_empty() {
        return refused(state, lost | Cause::NotPossible.into());
    }
    State { is_homed: true, is_zero_lost: false, ..state }.into()
}

fn unhome(state: State, owner: Owner) -> Transition {
    if state.operating != Operating::Disabled {
        return refused(state, Cause::NotPossible.into());
    }
    let is_zero_lost = state.is_zero_lost || owner == Owner::Person;
    State { is_homed: false, is_zero_lost, waits: None, ..state }.into()
}

fn move_on(state: State, owner: Owner) -> Transition {
    let mut against = if owner == Owner::Loop { Causes::NONE } else { Cause::NotAuthorized.into() };
    if state.operating != Operating::Enabled {
        against |= state.present | state.latched | Cause::NotEnabled.into();
    }
    if !against.is_empty() {
        return refused(state, against);
    }
    let moving = State { motion: Some(Owner::Loop), ..state };
    Transition { motion: Some(Motion::Move), ..moving.into() }
}

fn retract(state: State, owner: Owner, now_ns: Nanoseconds) -> Transition {
    if owner != Owner::Person {
        return refused(state, Cause::NotAuthorized.into());
    }
    let stops = state.operating == Operating::Enabled;
    let state = if stops { to(state, Operating::Paused, now_ns) } else { state };
    let state = State { motion: Some(owner), is_stopping: false, waits: None, ..held(state, Some(owner)) };
    Transition { stops, motion: Some(Motion::Retract), ..state.into() }
}

fn to(state: State, operating: Operating, now_ns: Nanoseconds) -> State {
    if state.operating == operating { state } else { State { operating, since_ns: now_ns, ..state } }
}

/// The state held by the owner with the highest authority of `owner` and the present holder.
fn held(state: State, owner: Option<Owner>) -> State {
    let held_by = [state.held_by, owner].into_iter().flatten().min();
    State { held_by, ..state }
}

fn latched(state: State, causes: Causes) -> State {
    State { latched: state.latched | causes, ..state }
}

fn stopped(state: State, causes: Causes) -> Transition {
    let state = State { motion: None, is_stopping: true, waits: None, ..state };
    Transition { stops: true, causes, ..state.into() }
}

fn stopped_if(stops: bool, state: State, causes: Causes) -> Transition {
    if stops { stopped(state, causes) } else { Transition { causes, ..state.into() } }
}

/// The transition with a stop; the stop of the loop leaves a retraction by a person in force.
fn stopped_by(owner: Owner, state: State, causes: Causes) -> Transition {
    if state.is_retracting() && owner == Owner::Loop {
        return Transition { causes, ..State { waits: None, ..state }.into() };
    }
    stopped(state, causes)
}

fn refused(state: State, causes: Causes) -> Transition {
    Transition { causes, is_refused: true, ..state.into() }
}
