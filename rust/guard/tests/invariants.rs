//! Invariants of the guard over all states that it can reach, all values at its limits, and all ends of its counters.

use std::collections::HashMap;

use needleplan_guard::advance::{ordered, validated};
use needleplan_guard::cause::{Cause, Causes, Owner};
use needleplan_guard::command::CommandLimits;
use needleplan_guard::state::{Motion, Operating, Order, Report, State};

/// A cause for each way in which the transitions treat causes: a pause, a fault, a motion in spite of a stop, the end of a
/// retraction, a lost zero.
const CAUSES: [Cause; 5] =
    [Cause::PoseUnseen, Cause::ForceExceeded, Cause::StillMoving, Cause::WrongWay, Cause::StageJumped];

/// What an observer notes beside the guard, from orders and measurements alone.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
struct Observed {
    /// Whether the needle was measured at rest, or a person moved it, since the last stop.
    has_rested: bool,
    /// Whether a person has given RESET since the last STOP and the last fault.
    is_examined: bool,
    /// Whether somebody has given ENABLE or RESUME since the last stop.
    is_begun: bool,
}

type Key = ([u64; 3], [u8; 8], Observed);

fn key(state: &State, observed: Observed) -> Key {
    let number = |owner: Option<Owner>| owner.map_or(9, |owner| owner as u8);
    let flags = u8::from(state.is_homed) | u8::from(state.is_zero_lost) << 1 | u8::from(state.is_stopping) << 2;
    let owners = [number(state.held_by), number(state.motion), number(state.waits)];
    let [held_by, motion, waits] = owners;
    let small = [state.operating as u8, flags, held_by, motion, waits, u8::from(state.is_busy), 0, 0];
    ([state.present.0, state.latched.0, state.first.0], small, observed)
}

fn reports() -> Vec<Report> {
    let mut all = Vec::new();
    for bits in 0..1 << CAUSES.len() {
        let present: Vec<Cause> = (0..CAUSES.len()).filter(|at| bits >> at & 1 == 1).map(|at| CAUSES[at]).collect();
        for flags in 0..8 {
            let (is_retracting, is_resting, is_busy) = (flags & 1 == 1, flags & 2 == 2, flags & 4 == 4);
            all.push(Report { causes: Causes::of(&present), is_busy, is_retracting, is_resting });
        }
    }
    all
}

/// After a stop, no motion inward is ordered until the needle was measured at rest and somebody has given an order; after a
/// STOP or a fault, not before a person has given RESET and somebody ENABLE.
#[test]
fn no_reachable_state_moves_inward_before_rest_and_orders() {
    let reports = reports();
    let begin = (State::default(), Observed { has_rested: true, is_examined: true, is_begun: false });
    let mut known = HashMap::from([(key(&begin.0, begin.1), ())]);
    let (mut waiting, mut steps, mut motions) = (vec![begin], 0_u64, 0_u64);
    while let Some((before, observed)) = waiting.pop() {
        let orders = Order::ALL.iter().flat_map(|order| Owner::ALL.map(|owner| (Some((*order, owner)), None)));
        for (order, report) in orders.chain(reports.iter().map(|report| (None, Some(*report)))) {
            let step = match (order, report) {
                (Some((order, owner)), _) => ordered(before, order, owner, 0),
                (_, Some(report)) => validated(before, report, 0),
                _ => unreachable!(),
            };
            steps += 1;
            if step.is_refused {
                assert_eq!(step.state, before);
                continue;
            }
            let mut after = observed;
            if step.motion == Some(Motion::Move) {
                motions += 1;
                assert_eq!((step.state.operating, step.state.motion), (Operating::Enabled, Some(Owner::Loop)));
                assert!(
                    after == Observed { has_rested: true, is_examined: true, is_begun: true },
                    "{before:?} {order:?}"
                );
            }
            after.has_rested |= report.is_some_and(|report| report.is_resting) || step.motion == Some(Motion::Retract);
            after.is_begun |= order.is_some_and(|(order, _)| matches!(order, Order::Enable | Order::Resume));
            after.is_examined |= order.is_some_and(|(order, owner)| order == Order::Reset && owner == Owner::Person);
            if step.stops && step.motion.is_none() {
                // The order or the cause that stops the needle ends an earlier rest and an earlier beginning.
                (after.has_rested, after.is_begun) = (false, false);
            }
            let is_fault = step.state.operating == Operating::Fault;
            if is_fault || order.is_some_and(|(order, _)| order == Order::Stop) {
                after.is_examined = false;
            }
            if known.insert(key(&step.state, after), ()).is_none() {
                waiting.push((step.state, after));
            }
        }
    }
    assert!(known.len() > 10_000 && motions > 0, "{} states, {steps} steps, {motions} motions", known.len());
    println!("{} states, {steps} steps, {motions} motions", known.len());
}

/// The values on both sides of a limit, and those that are no numbers.
fn beside(limits: &[f64]) -> Vec<f64> {
    let mut all = vec![0.0, -0.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN, f64::MIN_POSITIVE];
    all.extend(limits.iter().flat_map(|limit| [*limit, limit.next_up(), limit.next_down(), -limit]));
    all
}

/// Each motion is permitted if and only if it is within every limit, at all values at the limits.
#[test]
fn a_motion_is_permitted_within_the_limits_only() {
    let mut permitted = 0;
    for (shallowest_mm, deepest_mm) in [(-100.0, 150.0), (0.0, 0.5), (5.0, 6.0)] {
        let limits = CommandLimits {
            shallowest_mm,
            deepest_mm,
            insertion_velocity_mm_s: 10.0,
            retraction_velocity_mm_s: 20.0,
            roll_rad: 25.0,
            rotation_velocity_rad_s: 12.0,
        };
        let depths = beside(&[shallowest_mm, deepest_mm, 7.0]);
        let heres = depths.iter().copied().map(Some).chain([None]);
        for here_mm in heres {
            for depth_mm in &depths {
                for speed in beside(&[10.0, 20.0]) {
                    let is_deep = *depth_mm >= shallowest_mm && *depth_mm <= deepest_mm;
                    let is_outward = here_mm.is_some_and(|here_mm| *depth_mm <= here_mm);
                    let fastest = if is_outward { 20.0 } else { 10.0 };
                    let is_within = is_deep && speed > 0.0 && speed <= fastest;
                    let against = limits.against_insertion(here_mm, *depth_mm, speed);
                    assert_eq!(against.is_empty(), is_within, "{here_mm:?} {depth_mm} {speed}: {against:?}");
                    if limits.against_retraction(here_mm, *depth_mm, speed).is_empty() {
                        assert!(*depth_mm >= shallowest_mm && speed > 0.0 && speed <= 20.0);
                        assert!(here_mm.is_none() || is_outward);
                    }
                    permitted += u32::from(is_within);
                }
            }
        }
        for roll_rad in beside(&[25.0]) {
            for speed in beside(&[12.0]) {
                let is_within = roll_rad.abs() <= 25.0 && speed > 0.0 && speed <= 12.0;
                assert_eq!(limits.against_rotation(roll_rad, speed).is_empty(), is_within);
            }
        }
    }
    assert!(permitted > 100);
}

#[cfg(feature = "robot")]
mod robot_side {
    use needleplan_guard::cause::{Cause, Causes};
    use needleplan_guard::session::is_later;

    use crate::beside;
    use crate::robot::bench::{Bench, rules};

    /// Of two different numbers exactly one is later, but for numbers that are half of all apart: then neither is.
    #[test]
    fn numbers_are_later_as_on_a_circle() {
        let ends = [0, 1, 2, 3, 0x7FFF_FFFE, 0x7FFF_FFFF, 0x8000_0000, 0x8000_0001, u32::MAX - 1, u32::MAX];
        let near = |number: u32| (0..64).map(move |step| number.wrapping_add(step * 67_108_859));
        let all: Vec<u32> = ends.into_iter().chain(ends.into_iter().flat_map(near)).collect();
        for one in &all {
            for other in &all {
                let apart = one.wrapping_sub(*other);
                let is_half = apart == 1 << 31;
                assert_eq!(is_later(*one, *other), apart != 0 && apart < 1 << 31);
                assert_eq!(is_later(*one, *other) ^ is_later(*other, *one), apart != 0 && !is_half);
            }
        }
    }

    /// A measured value beyond a limit stops at once, one at a limit does not, and one that is no number is not used.
    #[test]
    fn a_measured_value_beyond_a_limit_trips_and_one_within_does_not() {
        let rules = rules();
        let trips = |depth_mm: f64, velocity_mm_s: f64, roll_rad: f64| {
            let mut bench = Bench::enabled();
            (bench.robot.depth_mm, bench.robot.velocity_mm_s, bench.robot.roll_rad) =
                (depth_mm, velocity_mm_s, roll_rad);
            bench.says();
            let is_stop = bench.sent().contains(&5);
            assert_eq!(is_stop, bench.trip().0 == 1);
            bench.trip().1
        };
        for depth_mm in beside(&[rules.depth_mm.0, rules.depth_mm.1]) {
            for velocity_mm_s in beside(&[rules.velocity_mm_s.0, rules.velocity_mm_s.1]) {
                for roll_rad in beside(&[rules.roll_rad]) {
                    let found = trips(depth_mm, velocity_mm_s, roll_rad);
                    if ![depth_mm, velocity_mm_s, roll_rad].iter().all(|value| value.is_finite()) {
                        assert_eq!(found, Causes::NONE);
                        continue;
                    }
                    let is_deep = depth_mm < rules.depth_mm.0 || depth_mm > rules.depth_mm.1;
                    let is_fast = velocity_mm_s > rules.velocity_mm_s.0 || velocity_mm_s < -rules.velocity_mm_s.1;
                    assert_eq!(found.has(Cause::DepthExceeded), is_deep, "{depth_mm}");
                    assert_eq!(found.has(Cause::Overspeed), is_fast, "{velocity_mm_s}");
                    assert_eq!(found.has(Cause::RollExceeded), roll_rad.abs() > rules.roll_rad, "{roll_rad}");
                }
            }
        }
    }
}

#[cfg(feature = "robot")]
mod robot;
