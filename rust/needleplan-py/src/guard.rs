//! The safety guard: numbers and bit masks in, numbers and bit masks out.

use needleplan_guard::advance::{ordered, validated};
use needleplan_guard::age::{self, Delay};
use needleplan_guard::cause::{Cause, Causes, Owner};
use needleplan_guard::command::CommandLimits;
use needleplan_guard::state::{Motion, Operating, Order, Report, State, Transition};
use needleplan_guard::{NEVER, deadman, repeat, rise};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// The fields of a state: operating state, homed, busy, present, latched, since, holder, owner of the motion, zero lost,
/// first causes, stopping, owner who waits.
pub(crate) type Fields = (u8, bool, bool, u64, u64, i64, Option<u8>, Option<u8>, bool, u64, bool, Option<u8>);

/// Next state, whether to stop, whether to move (0) or to retract (1), causes, and whether the order is refused.
type Step = (Fields, bool, Option<u8>, u64, bool);

/// Shallowest and deepest depth, velocities inward and outward, roll, velocity of the roll.
type Limits = (f64, f64, f64, f64, f64, f64);

pub(crate) fn known<T: Copy>(all: &[T], number: u8) -> PyResult<T> {
    all.get(usize::from(number))
        .copied()
        .ok_or_else(|| PyValueError::new_err(format!("no value has the number {number}")))
}

fn owner(number: Option<u8>) -> PyResult<Option<Owner>> {
    number.map(|number| known(&Owner::ALL, number)).transpose()
}

pub(crate) fn state(fields: Fields) -> PyResult<State> {
    let (
        operating,
        is_homed,
        is_busy,
        present,
        latched,
        since_ns,
        held_by,
        motion,
        is_zero_lost,
        first,
        is_stopping,
        waits,
    ) = fields;
    Ok(State {
        operating: known(&Operating::ALL, operating)?,
        is_homed,
        is_busy,
        present: Causes(present),
        latched: Causes(latched),
        since_ns,
        held_by: owner(held_by)?,
        motion: owner(motion)?,
        is_zero_lost,
        first: Causes(first),
        is_stopping,
        waits: owner(waits)?,
    })
}

pub(crate) fn never(time_ns: Option<i64>) -> i64 {
    time_ns.unwrap_or(NEVER)
}

/// None if nothing changes and nothing is to be done.
fn step(before: &State, transition: Transition) -> Option<Step> {
    if transition == Transition::from(*before) {
        return None;
    }
    let after = transition.state;
    let number = |owner: Option<Owner>| owner.map(|owner| owner as u8);
    let fields = (
        after.operating as u8,
        after.is_homed,
        after.is_busy,
        after.present.0,
        after.latched.0,
        after.since_ns,
        number(after.held_by),
        number(after.motion),
        after.is_zero_lost,
        after.first.0,
        after.is_stopping,
        number(after.waits),
    );
    let motion = transition.motion.map(|motion| u8::from(motion == Motion::Retract));
    Some((fields, transition.stops, motion, transition.causes.0, transition.is_refused))
}

/// Name, owner and severity (0 refusal, 1 pause, 2 fault) of each cause, by the number of its bit.
#[pyfunction]
pub(crate) fn guard_causes() -> Vec<(&'static str, u8, u8)> {
    Cause::ALL.iter().map(|cause| (cause.name(), cause.owner() as u8, cause.severity() as u8)).collect()
}

/// The transition after a validation of all inputs; None if nothing changes.
#[pyfunction]
pub(crate) fn guard_validated(
    before: Fields,
    causes: u64,
    is_busy: bool,
    is_retracting: bool,
    is_resting: bool,
    now_ns: i64,
) -> PyResult<Option<Step>> {
    let before = state(before)?;
    let report = Report { causes: Causes(causes), is_busy, is_retracting, is_resting };
    Ok(step(&before, validated(before, report, now_ns)))
}

/// The transition after an order of an owner; None if nothing changes.
#[pyfunction]
pub(crate) fn guard_ordered(before: Fields, order: u8, owner: u8, now_ns: i64) -> PyResult<Option<Step>> {
    let before = state(before)?;
    Ok(step(&before, ordered(before, known(&Order::ALL, order)?, known(&Owner::ALL, owner)?, now_ns)))
}

fn limits(numbers: Limits) -> CommandLimits {
    let (
        shallowest_mm,
        deepest_mm,
        insertion_velocity_mm_s,
        retraction_velocity_mm_s,
        roll_rad,
        rotation_velocity_rad_s,
    ) = numbers;
    CommandLimits {
        shallowest_mm,
        deepest_mm,
        insertion_velocity_mm_s,
        retraction_velocity_mm_s,
        roll_rad,
        rotation_velocity_rad_s,
    }
}

/// The causes against a motion to a depth.
#[pyfunction]
pub(crate) fn guard_against_insertion(numbers: Limits, here_mm: Option<f64>, depth_mm: f64, velocity_mm_s: f64) -> u64 {
    limits(numbers).against_insertion(here_mm, depth_mm, velocity_mm_s).0
}

/// The causes against a retraction by a person.
#[pyfunction]
pub(crate) fn guard_against_retraction(
    numbers: Limits,
    here_mm: Option<f64>,
    depth_mm: f64,
    velocity_mm_s: f64,
) -> u64 {
    limits(numbers).against_retraction(here_mm, depth_mm, velocity_mm_s).0
}

/// The causes against a rotation.
#[pyfunction]
pub(crate) fn guard_against_rotation(numbers: Limits, roll_rad: f64, velocity_rad_s: f64) -> u64 {
    limits(numbers).against_rotation(roll_rad, velocity_rad_s).0
}

/// The delay of a sample, and the three numbers (s) that the next call needs; `before` is None before the first sample.
#[pyfunction]
pub(crate) fn guard_delay(before: Option<[f64; 4]>, received_ns: i64, device_s: f64) -> [f64; 4] {
    let before = before.map_or_else(Delay::default, |[late_s, shortest_s, received_s, device_s]| Delay {
        late_s,
        shortest_s,
        received_s,
        device_s,
    });
    let after = before.then(received_ns, device_s);
    [after.late_s, after.shortest_s, after.received_s, after.device_s]
}

/// Freshness of a device (0 fresh, 1 failed, 2 stale, 3 unusable), and whether its last sample is of the future.
#[pyfunction]
pub(crate) fn guard_freshness(
    has_failed: bool,
    received_ns: Option<i64>,
    taken_ns: Option<i64>,
    usable_ns: Option<i64>,
    limit_s: f64,
    now_ns: i64,
) -> (u8, bool) {
    let freshness = age::freshness(has_failed, never(taken_ns), never(usable_ns), limit_s, now_ns);
    (freshness as u8, age::is_of_the_future(never(received_ns), now_ns))
}

/// Rise of the magnitude of the force.
#[pyclass(module = "needleplan._ppvi")]
#[derive(Default)]
pub(crate) struct ForceWindow(rise::ForceRise);

#[pymethods]
impl ForceWindow {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    fn observe(&mut self, time_ns: i64, force_n: f64) {
        self.0.observe(time_ns, force_n);
    }

    #[getter]
    fn rise_n(&self) -> f64 {
        self.0.rise_n()
    }

    fn exceeds(&self, limit_n_s: f64) -> bool {
        self.0.exceeds(limit_n_s)
    }
}

/// Times at which a stop is repeated.
#[pyclass(module = "needleplan._ppvi")]
#[derive(Default)]
pub(crate) struct RepeatedStop(repeat::RepeatedStop);

#[pymethods]
impl RepeatedStop {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    #[getter]
    fn arrived_ns(&self) -> Option<i64> {
        Some(self.0.arrived_ns()).filter(|time_ns| *time_ns != NEVER)
    }

    #[getter]
    fn is_on_its_way(&self) -> bool {
        self.0.is_on_its_way()
    }

    fn begin(&mut self) {
        self.0.begin();
    }

    #[pyo3(signature = (sent_ns, now_ns, *, arrived))]
    fn end(&mut self, sent_ns: i64, now_ns: i64, arrived: bool) {
        self.0.end(sent_ns, now_ns, arrived);
    }

    fn due(&self, now_ns: i64) -> bool {
        self.0.is_due(now_ns)
    }
}

/// Times of heartbeats.
#[pyclass(module = "needleplan._ppvi")]
pub(crate) struct HeartbeatTimer(repeat::Heartbeat);

#[pymethods]
impl HeartbeatTimer {
    #[new]
    fn new(now_ns: i64) -> Self {
        Self(repeat::Heartbeat { sent_ns: now_ns })
    }

    fn take(&mut self, now_ns: i64) -> bool {
        self.0.take(now_ns)
    }
}

/// The last signal of a deadman switch.
#[pyclass(module = "needleplan._ppvi")]
#[derive(Default)]
pub(crate) struct DeadmanTimer(deadman::Deadman);

#[pymethods]
impl DeadmanTimer {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    fn observe(&mut self, is_held: bool, now_ns: i64) {
        self.0.observe(is_held, now_ns);
    }

    fn is_released(&self, limit_s: f64, now_ns: i64) -> bool {
        self.0.is_released(limit_s, now_ns)
    }
}
