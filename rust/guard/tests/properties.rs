//! Invariants of the guard on random states and histories, without a second implementation.

use needleplan_guard::advance::{ordered, validated};
use needleplan_guard::age::{CLOCK_DRIFT, Delay, Freshness, freshness, is_of_the_future};
use needleplan_guard::cause::{Cause, Causes, Owner, Severity};
use needleplan_guard::command::CommandLimits;
use needleplan_guard::deadman::Deadman;
use needleplan_guard::repeat::{Heartbeat, RepeatedStop};
use needleplan_guard::rise::{CAPACITY, ForceRise, WINDOW_NS};
use needleplan_guard::state::{Motion, Operating, Order, Report, State, Transition};
use needleplan_guard::{NEVER, is_older};
use proptest::prelude::*;

const MS: i64 = 1_000_000;

#[derive(Clone, Copy, Debug)]
enum Event {
    Ordered(Order, Owner),
    Validated(Report),
}

fn causes() -> impl Strategy<Value = Causes> {
    prop_oneof![
        3 => Just(Causes::NONE),
        3 => proptest::sample::select(Cause::ALL).prop_map(Causes::from),
        1 => any::<u64>().prop_map(|bits| Causes(bits) & Causes::ALL),
    ]
}

fn owners() -> impl Strategy<Value = Owner> {
    proptest::sample::select(&Owner::ALL[..])
}

fn states() -> impl Strategy<Value = State> {
    (
        proptest::sample::select(&Operating::ALL[..]),
        any::<[bool; 4]>(),
        [causes(), causes(), causes()],
        [proptest::option::of(owners()), proptest::option::of(owners()), proptest::option::of(owners())],
    )
        // No history leads to a retraction in ENABLED.
        .prop_filter("a retraction in ENABLED", |(operating, _, _, owners)| {
            *operating != Operating::Enabled || owners[1] != Some(Owner::Person)
        })
        .prop_map(|(operating, flags, [present, latched, first], [held_by, motion, waits])| State {
            operating,
            is_homed: flags[0],
            is_busy: flags[1],
            present,
            latched,
            since_ns: 3,
            held_by,
            motion,
            is_zero_lost: flags[2],
            first,
            is_stopping: flags[3],
            waits,
        })
}

fn events() -> impl Strategy<Value = Event> {
    prop_oneof![
        (proptest::sample::select(&Order::ALL[..]), owners()).prop_map(|(order, owner)| Event::Ordered(order, owner)),
        (causes(), any::<[bool; 3]>()).prop_map(|(causes, [is_busy, is_retracting, is_resting])| {
            Event::Validated(Report { causes, is_busy, is_retracting, is_resting })
        }),
    ]
}

fn after(state: State, event: Event, now_ns: i64) -> Transition {
    match event {
        Event::Ordered(order, owner) => ordered(state, order, owner, now_ns),
        Event::Validated(report) => validated(state, report, now_ns),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_transition_keeps_the_rules(before in states(), event in events()) {
        let step = after(before, event, 7);
        let state = step.state;
        let is_order = matches!(event, Event::Ordered(..));
        let entered = |operating| state.operating == operating && before.operating != operating;
        if step.is_refused {
            prop_assert!(state == before && !step.stops && step.motion.is_none() && !step.causes.is_empty());
        }
        prop_assert_eq!(state.since_ns, if state.operating == before.operating { 3 } else { 7 });
        // Rule 1: orders neither cause nor end FAULT, which becomes DISABLED alone.
        if is_order {
            prop_assert_eq!(before.operating == Operating::Fault, state.operating == Operating::Fault);
        } else if before.operating == Operating::Fault {
            prop_assert!(matches!(state.operating, Operating::Fault | Operating::Disabled));
        }
        // Rule 2: ENABLED is entered without a cause, at rest, and never while a person retracts.
        if entered(Operating::Enabled) {
            prop_assert!(!state.is_stopping && state.waits.is_none() && state.held_by.is_none());
            prop_assert!(state.present.is_empty() || is_order);
            if is_order {
                prop_assert!(before.present.is_empty() && !before.is_retracting());
            }
        }
        // Rules 4 and 6: who may do what.
        if let Event::Ordered(order, owner) = event {
            let is_of_a_person = matches!(order, Order::Reset | Order::Retract);
            prop_assert!(step.is_refused || owner == Owner::Person || !is_of_a_person);
            prop_assert!(step.is_refused || owner == Owner::Loop || order != Order::Move);
            if order == Order::Stop {
                prop_assert!(state.latched.has(Cause::StopOrdered));
                prop_assert!(step.stops || (owner == Owner::Loop && before.is_retracting()));
            }
            if before.is_zero_lost && owner != Owner::Person {
                prop_assert!(before.is_homed || !state.is_homed);
            }
        }
        prop_assert_eq!(step.motion == Some(Motion::Retract), matches!(event, Event::Ordered(Order::Retract, _)) && !step.is_refused);
        if step.motion == Some(Motion::Move) {
            prop_assert!(state.operating == Operating::Enabled && state.motion == Some(Owner::Loop));
        }
        // Rule 7: leaving ENABLED, and the end of a retraction, stop the needle.
        let has_left = before.operating == Operating::Enabled && state.operating != Operating::Enabled;
        if has_left || (before.is_retracting() && !state.is_retracting()) {
            prop_assert!(step.stops);
        }
        if step.stops && step.motion.is_none() {
            prop_assert!(state.is_stopping && state.motion.is_none() && state.waits.is_none());
        }
        // The lost zero is found by HOME alone.
        if state.present.has(Cause::StageJumped) && !is_order {
            prop_assert!(!state.is_homed || state == before);
        }
    }

    /// After a STOP, no motion inward is ordered until the needle was measured at rest, and a person has reset the guard.
    #[test]
    fn after_a_stop_nothing_moves_inward_without_rest_and_a_person(
        before in states(), owner in owners(), then in proptest::collection::vec(events(), 1..40),
    ) {
        let mut state = ordered(before, Order::Stop, owner, 0).state;
        let (mut has_rested, mut is_reset) = (!state.is_stopping, false);
        for event in then {
            let step = after(state, event, 1);
            if let Event::Ordered(order, Owner::Person) = event {
                is_reset |= order == Order::Reset && !step.is_refused;
                has_rested |= order == Order::Retract; // a person moves the needle outward
            }
            if let Event::Validated(report) = event {
                has_rested |= report.is_resting;
            }
            prop_assert!(step.motion != Some(Motion::Move) || (has_rested && is_reset));
            state = step.state;
        }
    }

    #[test]
    fn a_permitted_command_is_within_every_limit(
        here_mm in proptest::option::of(-200.0..200.0), depth_mm in any::<f64>(), speed in any::<f64>(),
        near_mm in -160.0..160.0, slow in -1.0..30.0,
    ) {
        let limits = LIMITS;
        for (depth_mm, speed) in [(depth_mm, speed), (near_mm, slow), (near_mm, speed), (depth_mm, slow)] {
            if limits.against_insertion(here_mm, depth_mm, speed).is_empty() {
                prop_assert!((-100.0..=150.0).contains(&depth_mm) && speed > 0.0);
                prop_assert!(speed <= 10.0 || (speed <= 20.0 && here_mm.is_some_and(|here_mm| depth_mm <= here_mm)));
            }
            if limits.against_retraction(here_mm, depth_mm, speed).is_empty() {
                prop_assert!(depth_mm >= -100.0 && depth_mm <= here_mm.unwrap_or(-100.0) && speed > 0.0 && speed <= 20.0);
            }
            if limits.against_rotation(depth_mm, speed).is_empty() {
                prop_assert!(depth_mm.abs() <= 25.0 && speed > 0.0 && speed <= 12.0);
            }
        }
    }

    /// The window beside the smallest force of the last 50 ms, found in the list of all.
    #[test]
    fn the_rise_is_that_above_the_minimum_of_the_window(
        samples in proptest::collection::vec((prop_oneof![0..20 * MS, 0..2 * WINDOW_NS, Just(WINDOW_NS / 2)], 0.0..10.0), 1..200),
    ) {
        let (mut rise, mut time_ns, mut all) = (ForceRise::new(), 0, Vec::new());
        for (step_ns, force_n) in samples {
            time_ns += step_ns;
            all.push((time_ns, force_n));
            rise.observe(time_ns, force_n);
            rise.observe(time_ns, f64::NAN);
            let window = all.iter().filter(|(then_ns, _)| time_ns - then_ns <= WINDOW_NS);
            let least = window.fold(f64::INFINITY, |least, (_, force_n)| least.min(*force_n));
            prop_assert_eq!(rise.rise_n(), force_n - least);
            prop_assert!(!rise.exceeds(rise.rise_n() / 0.05 + 1e-6));
            prop_assert!(rise.exceeds(rise.rise_n() / 0.05 - 1e-6));
        }
    }

    /// A delay is never negative, at most the way beyond the shortest, and at least that less the drift.
    #[test]
    fn a_delay_is_the_way_beyond_the_shortest(ways_s in proptest::collection::vec(0.0..0.009_f64, 1..60)) {
        let mut delay = Delay::default();
        for (number, way_s) in ways_s.iter().enumerate() {
            let taken_s = number as f64 * 0.01;
            delay = delay.then(((123.0 + taken_s + way_s) * 1e9) as i64, 7e4 + taken_s);
            let slow_s = way_s - ways_s[..=number].iter().fold(f64::INFINITY, |least, way_s| least.min(*way_s));
            prop_assert!(delay.late_s >= 0.0 && delay.late_s <= slow_s + 1e-6);
            prop_assert!(delay.late_s >= slow_s - CLOCK_DRIFT * (taken_s + 0.009) - 1e-6);
        }
    }

    #[test]
    fn no_time_makes_a_function_panic(
        times in any::<[i64; 4]>(), numbers in any::<[f64; 2]>(), has_failed in any::<bool>(),
    ) {
        let [first, second, third, fourth] = times;
        let mut stop = RepeatedStop::default();
        stop.end(first, second, has_failed);
        stop.begin();
        prop_assert!(!stop.is_due(third) && stop.is_on_its_way());
        stop.end(third, fourth, has_failed);
        prop_assert_eq!(stop.arrived_ns() == NEVER, !has_failed || fourth == NEVER);
        let mut rise = ForceRise::new();
        for time_ns in times {
            rise.observe(time_ns, numbers[0]);
            let is_due = Heartbeat { sent_ns: time_ns }.take(first);
            prop_assert_eq!(is_due, first.saturating_sub(time_ns) >= 4_500_000);
        }
        let found = freshness(has_failed, first, second, numbers[1], third);
        prop_assert_eq!(found == Freshness::Failed, has_failed);
        prop_assert_eq!(is_of_the_future(first, second), first != NEVER && first.saturating_sub(second) > 5 * MS);
        prop_assert!(is_older(NEVER, numbers[0], first));
        let mut deadman = Deadman::default();
        prop_assert!(deadman.is_released(numbers[0], first));
        deadman.observe(true, second);
        deadman.observe(false, third);
        prop_assert!(deadman.is_released(f64::INFINITY, fourth));
        let _ = Delay::default().then(first, numbers[0]).then(second, numbers[1]);
    }
}

const LIMITS: CommandLimits = CommandLimits {
    shallowest_mm: -100.0,
    deepest_mm: 150.0,
    insertion_velocity_mm_s: 10.0,
    retraction_velocity_mm_s: 20.0,
    roll_rad: 25.0,
    rotation_velocity_rad_s: 12.0,
};

#[test]
fn each_refused_command_has_its_causes() {
    let none = Causes::NONE;
    let set = |causes: &[Cause]| Causes::of(causes);
    assert_eq!(LIMITS.against_insertion(Some(0.0), 150.0, 10.0), none);
    assert_eq!(LIMITS.against_insertion(Some(0.0), -100.0, 20.0), none);
    assert_eq!(LIMITS.against_insertion(None, -100.0, 20.0), set(&[Cause::VelocityBeyond]));
    assert_eq!(LIMITS.against_insertion(None, 151.0, 0.0), set(&[Cause::VelocityBeyond, Cause::DepthBeyond]));
    assert_eq!(LIMITS.against_insertion(Some(0.0), f64::NAN, 1.0), set(&[Cause::NotFinite]));
    assert_eq!(LIMITS.against_insertion(Some(0.0), 1.0, f64::INFINITY), set(&[Cause::NotFinite]));
    assert_eq!(LIMITS.against_retraction(Some(5.0), 5.0, 20.0), none);
    assert_eq!(LIMITS.against_retraction(Some(5.0), 5.1, 20.1), set(&[Cause::NotARetraction, Cause::VelocityBeyond]));
    assert_eq!(LIMITS.against_retraction(None, -100.0, 1.0), none);
    assert_eq!(LIMITS.against_retraction(None, -100.1, 1.0), set(&[Cause::DepthBeyond]));
    assert_eq!(LIMITS.against_retraction(None, f64::NAN, 1.0), set(&[Cause::NotFinite]));
    assert_eq!(LIMITS.against_rotation(-25.0, 12.0), none);
    assert_eq!(LIMITS.against_rotation(25.1, -1.0), set(&[Cause::RollBeyond, Cause::RotationBeyond]));
    assert_eq!(LIMITS.against_rotation(1.0, f64::NAN), set(&[Cause::NotFinite]));
}

#[test]
fn a_full_window_is_a_rise_until_its_forces_are_old() {
    let mut rise = ForceRise::new();
    for number in 0..CAPACITY as i64 {
        rise.observe(number * 50_000, number as f64 * 1e-6);
    }
    assert!(!rise.exceeds(1.0));
    let full_ns = CAPACITY as i64 * 50_000;
    rise.observe(full_ns, 1.0);
    assert!(rise.exceeds(1e12));
    rise.observe(full_ns + WINDOW_NS, 0.0);
    assert!(rise.exceeds(1e12));
    rise.observe(full_ns + WINDOW_NS + 1, 0.0);
    assert!(!rise.exceeds(0.0));
    assert!(rise.exceeds(f64::NAN));
}

#[test]
fn a_stop_is_repeated_after_20_ms_or_ten_times_what_it_took() {
    for (took_ms, has_arrived, wait_ms) in [(1, true, 20), (5, true, 50), (300, true, 1000), (1, false, 250)] {
        let mut stop = RepeatedStop::default();
        stop.begin();
        stop.end(7 * MS, (7 + took_ms) * MS, has_arrived);
        assert_eq!(stop.is_on_its_way(), !has_arrived);
        assert_eq!(stop.arrived_ns(), if has_arrived { (7 + took_ms) * MS } else { NEVER });
        assert!(!stop.is_due((7 + took_ms + wait_ms) * MS - 1));
        assert!(stop.is_due((7 + took_ms + wait_ms) * MS));
    }
    let mut two = RepeatedStop::default();
    two.begin();
    two.begin();
    two.end(0, MS, true);
    assert!(two.is_on_its_way() && two.arrived_ns() == NEVER && !two.is_due(i64::MAX));
}

#[test]
fn limits_of_age_are_inclusive() {
    let fresh = |taken_ns, usable_ns| freshness(false, taken_ns, usable_ns, 0.03, 100 * MS);
    assert_eq!(fresh(70 * MS, 70 * MS), Freshness::Fresh);
    assert_eq!(fresh(70 * MS, 70 * MS - 1), Freshness::Unusable);
    assert_eq!(fresh(70 * MS - 1, 70 * MS - 1), Freshness::Stale);
    assert_eq!(fresh(70 * MS, NEVER), Freshness::Unusable);
    assert!(is_older(0, f64::NAN, 0));
    assert!(!is_of_the_future(5 * MS, 0) && is_of_the_future(5 * MS + 1, 0));
    let mut deadman = Deadman::default();
    deadman.observe(true, MS);
    assert!(!deadman.is_released(0.2, 201 * MS) && deadman.is_released(0.2, 201 * MS + 1));
    let mut heartbeat = Heartbeat { sent_ns: 0 };
    assert!(!heartbeat.take(4_499_999) && heartbeat.take(4_500_000) && heartbeat.sent_ns == 4_500_000);
}

#[test]
fn a_device_clock_that_goes_back_begins_anew() {
    let delay = Delay::default().then(1_000_000_000, 50.0).then(1_200_000_000, 50.1);
    assert!((delay.late_s - 0.1).abs() < 1e-4);
    assert_eq!(delay.then(1_300_000_000, 0.0).late_s, 0.0);
}

#[test]
fn causes_have_numbers_names_owners_and_severities() {
    for (number, cause) in Cause::ALL.iter().enumerate() {
        assert_eq!(*cause as usize, number);
        assert!(Causes::from(*cause).has(*cause) && Causes::from(*cause).0 == 1 << number);
        assert_eq!(Causes::REFUSALS.has(*cause), cause.severity() == Severity::Refusal);
        assert_eq!(Causes::FAULTS.has(*cause), cause.severity() == Severity::Fault);
    }
    assert!(Causes::REFUSALS.meets(Causes::REFUSALS) && !Causes::REFUSALS.meets(Causes::FAULTS));
    assert_eq!(Causes::of(&[Cause::ForceStale, Cause::StageFault, Cause::LoopLate]).first_owner(), Some(Owner::Robot));
    assert_eq!(Causes::NONE.first_owner(), None);
}

#[test]
fn only_a_person_resets_and_only_without_a_fault() {
    for owner in Owner::ALL {
        for operating in Operating::ALL {
            let state = State { operating, latched: Cause::ForceStale.into(), ..State::default() };
            let step = ordered(state, Order::Reset, owner, 0);
            let may = owner == Owner::Person && operating != Operating::Fault;
            assert_eq!((step.is_refused, step.state.latched.is_empty()), (!may, may));
        }
    }
}

#[test]
fn a_window_that_overflows_loses_one_force_at_a_time_and_knows_the_rise_again_after_50_ms() {
    let mut rise = ForceRise::new();
    for number in 0..512 {
        rise.observe(number, number as f64);
        assert_eq!(rise.rise_n(), number as f64);
    }
    for number in 512..600 {
        rise.observe(number, number as f64);
        assert_eq!(rise.rise_n(), f64::INFINITY);
    }
    rise.observe(599 + WINDOW_NS, 600.0);
    assert_eq!(rise.rise_n(), f64::INFINITY);
    // Only the force of 1 ns before the last is in the window, and the last.
    rise.observe(600 + WINDOW_NS, 601.0);
    assert_eq!(rise.rise_n(), 1.0);
}

#[test]
fn a_device_clock_that_drifts_within_the_bound_causes_no_delay() {
    let mut delay = Delay::default();
    for second in 0..1000 {
        let device_s = f64::from(second) * (1.0 - 0.9 * CLOCK_DRIFT);
        delay = delay.then(i64::from(second) * 1000 * MS, device_s);
        assert!(delay.late_s < 1e-6, "{second}");
    }
}
