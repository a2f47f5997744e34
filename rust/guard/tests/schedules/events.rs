//! What happens to guard, supervisor and robot, and what may go wrong.

use needleplan_guard::cause::{Cause, Owner};
use needleplan_guard::state::Order;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    Ordered(Order, Owner),
    /// A person sends a STOP, and its order follows two slots later.
    EarlyStop,
    /// A person examines what happened, and lets the loop go on.
    Restart,
    Begins(Cause),
    /// The loop orders a motion to another depth.
    Moves,
    Hangs,
    /// Program and supervisor are killed.
    Dies,
    /// A person sends a STOP, and the program hangs one slot later.
    LastStop,
}

/// A mistake of the program, of the supervisor or of the robot that the schedules must find.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mutant {
    /// The robot executes commands that are older than its last one.
    OldNumbers,
    /// Neither the supervisor nor the program sends a STOP again.
    NoRepetition,
    /// The program takes a braking needle for one that rests.
    RestsAtOnce,
    /// Heartbeats go on when the program hangs, and its silence is not noticed.
    NeverLate,
    /// The robot has no watchdog.
    NoWatchdog,
    /// The supervisor passes motions on in every state, and the program sends them in every state.
    PassesAll,
}

pub const EVENTS: [Event; 12] = [
    Event::Ordered(Order::Stop, Owner::Person),
    Event::Ordered(Order::Pause, Owner::Person),
    Event::Ordered(Order::Retract, Owner::Person),
    Event::Ordered(Order::Stop, Owner::Loop),
    Event::EarlyStop,
    Event::Restart,
    Event::Begins(Cause::ForceExceeded),
    Event::Begins(Cause::PoseUnseen),
    Event::Moves,
    Event::Hangs,
    Event::Dies,
    Event::LastStop,
];

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fate {
    Lost,
    /// It arrives, and once more some slots later.
    Again(i64),
    /// It arrives some slots later than the others.
    Late(i64),
}

/// What may become of one datagram: its direction (to the robot or from it), its number after the first event, its fate.
pub type Fault = (bool, usize, Fate);

/// What happens, in the order of its slots; which datagrams meet a fault, and how far all numbers were counted before.
#[derive(Clone, Debug)]
pub struct Schedule {
    pub events: Vec<(i64, Event)>,
    pub faults: Vec<Fault>,
    pub counted: u32,
}
