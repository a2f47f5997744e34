//! The state of the guard, the events that change it, and what a change requires.

use crate::Nanoseconds;
use crate::cause::{Causes, Owner};

/// Operating state of the guard, with the names of CRTK (Collaborative Robotics Toolkit).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Operating {
    /// Only a person moves the needle, by a retraction.
    #[default]
    Disabled,
    /// The needle follows the loop.
    Enabled,
    /// The needle waits for the order RESUME.
    Paused,
    /// A fault is present.
    Fault,
}

/// An order to the guard, or an order to move the needle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Order {
    /// Begin a run.
    Enable,
    /// End a run.
    Disable,
    /// Interrupt a run.
    Pause,
    /// Continue an interrupted run.
    Resume,
    /// Confirm that the latched causes have been examined; allows ENABLE again.
    Reset,
    /// Stop the needle.
    Stop,
    /// Declare that the zero of the stage is known.
    Home,
    /// Declare that the zero of the stage is not known.
    Unhome,
    /// Insert, withdraw or rotate the needle, by the loop.
    Move,
    /// Pull the needle out, by a person.
    Retract,
}

impl Operating {
    /// All states, by their numbers.
    pub const ALL: [Operating; 4] = [Operating::Disabled, Operating::Enabled, Operating::Paused, Operating::Fault];
}

impl Order {
    /// All orders, by their numbers.
    pub const ALL: [Order; 10] = [
        Order::Enable,
        Order::Disable,
        Order::Pause,
        Order::Resume,
        Order::Reset,
        Order::Stop,
        Order::Home,
        Order::Unhome,
        Order::Move,
        Order::Retract,
    ];
}

/// State of the guard.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct State {
    /// Operating state.
    pub operating: Operating,
    /// Whether the zero of the stage is known.
    pub is_homed: bool,
    /// Whether the stage moves.
    pub is_busy: bool,
    /// Causes that are present.
    pub present: Causes,
    /// Causes that are latched until RESET.
    pub latched: Causes,
    /// Time at which `operating` was entered.
    pub since_ns: Nanoseconds,
    /// Owner with the highest authority of those who stopped, paused or retracted the needle.
    pub held_by: Option<Owner>,
    /// Owner of the motion in force; `Person` for a retraction.
    pub motion: Option<Owner>,
    /// Whether only a person may declare the zero of the stage known again.
    pub is_zero_lost: bool,
    /// Causes of the last transition to FAULT or PAUSED, or of the STOP that ended a run.
    pub first: Causes,
    /// Whether the stage was stopped, and the needle has not been measured at rest since.
    pub is_stopping: bool,
    /// Owner of an ENABLE or RESUME that waits for the needle to rest.
    pub waits: Option<Owner>,
}

impl State {
    /// Whether a retraction by a person is in force.
    #[must_use]
    pub fn is_retracting(&self) -> bool {
        self.motion == Some(Owner::Person)
    }
}

/// The result of a validation of all inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Causes that are present.
    pub causes: Causes,
    /// Whether the stage moves.
    pub is_busy: bool,
    /// Whether the stage still carries out a retraction; matters only while one is in force.
    pub is_retracting: bool,
    /// Whether the needle was measured at rest after the last stop, and no stop or command is on its way.
    pub is_resting: bool,
}

/// Motion that a transition requires, after its stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// The motion that the loop ordered.
    Move,
    /// The retraction that a person ordered.
    Retract,
}

/// Next state, and the actions that it requires. A refused order leaves the state unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transition {
    /// Next state.
    pub state: State,
    /// Whether to send a STOP, before the motion.
    pub stops: bool,
    /// Motion to begin.
    pub motion: Option<Motion>,
    /// Causes of the stop or of the refusal.
    pub causes: Causes,
    /// Whether the order is refused.
    pub is_refused: bool,
}

impl From<State> for Transition {
    fn from(state: State) -> Transition {
        Transition { state, stops: false, motion: None, causes: Causes::NONE, is_refused: false }
    }
}
