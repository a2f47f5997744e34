//! Errors: rules that an input breaks. How a solve ended is not an error but a [`crate::Status`].

use thiserror::Error;

/// A rule that an input breaks. The message names the place of the mistake and the value found there.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Error {
    /// A scalar parameter is outside its range.
    #[error("{name} = {value}: {rule}")]
    Parameter {
        /// Name of the parameter in the caller's interface.
        name: &'static str,
        /// The value found.
        value: String,
        /// The broken rule, as a sentence without a subject ("must be ...").
        rule: &'static str,
    },
    /// An array has the wrong length.
    #[error("{name}: expected {expected} elements, found {found}")]
    Length {
        /// Name of the array.
        name: &'static str,
        /// The length it must have.
        expected: usize,
        /// The length it has.
        found: usize,
    },
    /// A row of a tabular problem breaks a rule. State and action are the first that do.
    #[error("state {state}, action {action}: {what} ({value})")]
    Row {
        /// First state, in index order, whose row is wrong.
        state: usize,
        /// Action of that row.
        action: usize,
        /// The rule that is broken.
        what: &'static str,
        /// The number that breaks it.
        value: f64,
    },
    /// The problem does not fit the machine or the index type.
    #[error("the problem needs {needed_bytes} bytes ({states} states): {rule}")]
    TooLarge {
        /// Number of states of the problem.
        states: u128,
        /// Bytes that the solver would allocate.
        needed_bytes: u128,
        /// The limit that is exceeded.
        rule: &'static str,
    },
    /// The work was abandoned because its [`StopFlag`](crate::StopFlag) was raised.
    #[error("stopped")]
    Stopped,
}

/// Result of a fallible function of this crate.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Makes an [`Error::Parameter`].
    pub fn parameter(name: &'static str, value: impl ToString, rule: &'static str) -> Error {
        Error::Parameter { name, value: value.to_string(), rule }
    }
}
