//! The supervisor beside a robot of hand-written bytes: when it stops, what it lets pass, when it sends heartbeats.
#![cfg(feature = "robot")]

mod robot;

use needleplan_guard::cause::{Cause, Causes, Owner};
use needleplan_guard::datagram::{Kind, LONGEST, SessionLimits};
use needleplan_guard::session::Session;
use needleplan_guard::state::{Operating, State};
use robot::Robot;
use robot::bench::{Bench, MS};

const STOP: u8 = Kind::Stop as u8;
const ALIVE: u8 = Kind::Alive as u8;

#[test]
fn a_healthy_run_gets_heartbeats_alone() {
    let mut bench = Bench::enabled();
    let sent = bench.sent_within(100, |bench| {
        bench.says();
        bench.lives();
    });
    assert!(sent.iter().all(|(_, kind)| *kind == ALIVE));
    assert_eq!(sent.iter().map(|(passed, _)| *passed).collect::<Vec<_>>(), (1..=20).map(|n| 5 * n).collect::<Vec<_>>());
    assert_eq!(bench.trip(), (0, Causes::NONE));
}

#[test]
fn a_sample_beyond_a_limit_stops_at_once_and_within_it_does_not() {
    type Spoil = fn(&mut Robot);
    let beyond: [(Cause, Spoil); 6] = [
        (Cause::DepthExceeded, |robot| robot.depth_mm = 100.001),
        (Cause::DepthExceeded, |robot| robot.depth_mm = -1.001),
        (Cause::Overspeed, |robot| robot.velocity_mm_s = 15.001),
        (Cause::Overspeed, |robot| robot.velocity_mm_s = -30.001),
        (Cause::RollExceeded, |robot| robot.roll_rad = -25.001),
        (Cause::StageFault, |robot| robot.state = 3),
    ];
    for (cause, spoil) in beyond {
        let mut bench = Bench::enabled();
        spoil(&mut bench.robot);
        bench.says();
        assert_eq!(bench.sent(), [STOP]);
        assert_eq!(bench.trip(), (1, cause.into()));
        assert_eq!(bench.supervisor.trip().time_ns, bench.now_ns);
    }
    let within: [Spoil; 5] = [
        |robot| robot.depth_mm = 100.0,
        |robot| robot.depth_mm = -1.0,
        |robot| robot.velocity_mm_s = 15.0,
        |robot| robot.velocity_mm_s = -30.0,
        |robot| robot.roll_rad = 25.0,
    ];
    for spoil in within {
        let mut bench = Bench::enabled();
        spoil(&mut bench.robot);
        bench.says();
        assert_eq!(bench.sent(), []);
    }
}

#[test]
fn a_stop_is_repeated_until_the_robot_stands_by_a_later_status() {
    let mut bench = Bench::enabled();
    bench.robot.depth_mm = 200.0;
    bench.says();
    assert_eq!(bench.sent(), [STOP]);
    // Standing, but by a status that was sent before the robot had accepted the stop.
    bench.robot.flags = 6;
    let sent = bench.sent_within(60, Bench::says);
    let stops: Vec<_> = sent.iter().filter(|(_, kind)| *kind == STOP).map(|(passed, _)| *passed).collect();
    assert_eq!(stops, [20, 40, 60]);
    bench.robot.number = bench.supervisor.session.last_number();
    bench.robot.flags = 1;
    assert!(bench.sent_within(20, Bench::says).contains(&(20, STOP)));
    bench.robot.number = bench.supervisor.session.last_number();
    bench.robot.flags = 4;
    assert_eq!(bench.sent_within(100, Bench::says), []);
    assert_eq!(bench.trip(), (1, Cause::DepthExceeded.into()));
}

#[test]
fn an_old_robot_stands_when_it_does_not_move() {
    let mut bench = Bench::enabled();
    (bench.robot.version, bench.robot.flags) = (2, 1);
    bench.robot.depth_mm = 200.0;
    bench.says();
    assert_eq!(bench.sent(), [STOP]);
    bench.robot.number = bench.supervisor.session.last_number();
    bench.robot.flags = 1;
    bench.says();
    assert!(bench.sent_within(25, |_| ()).contains(&(20, STOP)));
    bench.robot.number = bench.supervisor.session.last_number();
    bench.robot.flags = 0;
    bench.says();
    bench.post.state.operating = Operating::Fault;
    assert!(!bench.sent_within(50, |_| ()).iter().any(|(_, kind)| *kind == STOP));
}

#[test]
fn a_loop_that_hangs_loses_its_heartbeats_and_is_stopped() {
    let mut bench = Bench::enabled();
    bench.rules.force_age_s = f64::INFINITY;
    bench.rules.pose_age_s = f64::INFINITY;
    bench.posts();
    let sent = bench.sent_within(60, Bench::says);
    let beats: Vec<_> = sent.iter().filter(|(_, kind)| *kind == ALIVE).map(|(passed, _)| *passed).collect();
    assert_eq!(beats, [5, 10, 15, 20, 25, 30, 35, 40]);
    assert_eq!(sent.iter().find(|(_, kind)| *kind == STOP), Some(&(46, STOP)));
    assert_eq!(bench.trip(), (1, Cause::LoopLate.into()));
}

#[test]
fn heartbeats_that_are_withheld_are_not_sent_until_the_next_tick() {
    let mut bench = Bench::enabled();
    bench.supervisor.withhold();
    assert_eq!(bench.sent_within(20, Bench::says), []);
    bench.lives();
    assert_eq!(bench.sent(), [ALIVE]);
}

#[test]
fn every_input_that_the_program_posts_has_an_age() {
    type Spoil = fn(&mut Bench);
    let cases: [(Cause, i64, Spoil); 7] = [
        (Cause::StageStale, 31, |_| ()),
        (Cause::ForceStale, 31, |bench| bench.says()),
        (Cause::PoseStale, 46, |bench| {
            bench.says();
            bench.post.force = bench.fresh();
        }),
        (Cause::ForceSuspect, 31, |bench| {
            bench.says();
            bench.post.force.taken_ns = bench.now_ns;
            bench.post.pose = bench.fresh();
        }),
        (Cause::PoseSuspect, 46, |bench| {
            bench.says();
            bench.post.force = bench.fresh();
            bench.post.pose.taken_ns = bench.now_ns;
        }),
        (Cause::PoseUnseen, 46, |bench| {
            bench.says();
            bench.post.force = bench.fresh();
            bench.post.pose.taken_ns = bench.now_ns;
            bench.post.pose.is_unseen = true;
        }),
        (Cause::DeadmanReleased, 21, |bench| {
            bench.says();
            bench.rules.deadman_age_s = 0.02;
            bench.post.force = bench.fresh();
            bench.post.pose = bench.post.force;
        }),
    ];
    for (cause, due, spoil) in cases {
        let mut bench = Bench::enabled();
        bench.post.deadman_ns = bench.now_ns;
        let sent = bench.sent_within(80, |bench| {
            spoil(bench);
            bench.posts();
            bench.supervisor.tick(bench.now_ns);
        });
        let stop = sent.iter().find(|(_, kind)| *kind == STOP);
        assert_eq!(stop, Some(&(due, STOP)), "{}", cause.name());
        assert!(bench.trip().1.has(cause), "{}", cause.name());
    }
}

#[test]
fn a_stream_that_is_delayed_is_stale() {
    let mut bench = Bench::enabled();
    bench.now_ns += 40 * MS;
    bench.lives();
    bench.robot.late_ns = 31 * MS;
    bench.says();
    assert_eq!(bench.sent(), [STOP, ALIVE]);
    assert_eq!(bench.trip(), (1, Cause::StageStale.into()));
}

#[test]
fn samples_that_are_no_numbers_are_suspect() {
    let mut bench = Bench::enabled();
    bench.robot.depth_mm = f64::NAN;
    let sent = bench.sent_within(40, |bench| {
        bench.says();
        bench.lives();
    });
    assert_eq!(sent.iter().find(|(_, kind)| *kind == STOP), Some(&(31, STOP)));
    assert_eq!(bench.trip(), (1, Cause::StageSuspect.into()));
    let mut bench = Bench::enabled();
    (bench.robot.depth_mm, bench.robot.state) = (f64::NAN, 3);
    bench.says();
    assert_eq!(bench.sent(), [STOP]);
}

#[test]
fn after_a_trip_no_motion_passes_until_the_program_knows_of_it() {
    let mut bench = Bench::enabled();
    assert!(bench.passes(Kind::Insert) && bench.passes(Kind::Rotate));
    bench.robot.depth_mm = 200.0;
    bench.says();
    bench.sent();
    bench.robot.depth_mm = 0.0;
    bench.says();
    bench.lives(); // enabled, as the program believes that knows of no trip
    assert!(!bench.passes(Kind::Insert) && !bench.passes(Kind::Rotate));
    for kind in [Kind::Stop, Kind::Alive, Kind::Reset, Kind::Unhome, Kind::Goodbye] {
        assert!(bench.passes(kind));
    }
    bench.post.trips = Some(1);
    bench.lives();
    assert!(bench.passes(Kind::Insert) && bench.passes(Kind::Rotate));
}

#[test]
fn a_motion_that_passes_ends_the_repetition_of_the_stop_before() {
    let mut bench = Bench::enabled();
    assert!(bench.passes(Kind::Stop));
    assert!(bench.sent_within(20, Bench::says).contains(&(20, STOP)));
    bench.lives();
    assert!(bench.passes(Kind::Insert));
    let sent = bench.sent_within(40, |bench| {
        bench.says();
        bench.lives();
    });
    assert!(!sent.iter().any(|(_, kind)| *kind == STOP));
}

#[test]
fn a_motion_that_is_sent_again_after_a_stop_does_not_pass_and_the_stop_is_repeated() {
    let mut bench = Bench::enabled();
    let motion = bench.supervisor.session.next_number();
    let now_ns = bench.now_ns;
    assert!(bench.supervisor.command(Kind::Insert, motion, 0, (1.0, 1.0), now_ns, &mut [0; LONGEST]) > 0);
    assert!(bench.passes(Kind::Stop));
    assert_eq!(bench.supervisor.command(Kind::Insert, motion, 0, (1.0, 1.0), now_ns, &mut [0; LONGEST]), 0);
    assert!(bench.sent_within(20, Bench::says).contains(&(20, STOP)));
    bench.lives();
    assert!(bench.passes(Kind::Insert));
}

#[test]
fn only_an_enabled_guard_and_a_person_who_retracts_move() {
    for operating in Operating::ALL {
        for motion in [None, Some(Owner::Loop), Some(Owner::Person)] {
            let mut bench = Bench::enabled();
            bench.post.state = State { operating, motion, ..State::default() };
            bench.posts();
            let may = operating == Operating::Enabled || motion == Some(Owner::Person);
            assert_eq!(bench.passes(Kind::Insert), may);
        }
    }
}

#[test]
fn a_person_retracts_after_a_trip_that_the_program_does_not_know() {
    let mut bench = Bench::enabled();
    bench.robot.depth_mm = 200.0;
    bench.says();
    bench.sent();
    bench.post.state = State { operating: Operating::Paused, motion: Some(Owner::Person), ..State::default() };
    bench.posts();
    assert!(!bench.passes(Kind::Insert));
    bench.post.trips = None;
    bench.posts();
    assert!(bench.passes(Kind::Insert));
    // Too deep it still is, and on its way out: nothing stops it.
    let sent = bench.sent_within(100, Bench::says);
    assert!(!sent.iter().any(|(_, kind)| *kind == STOP));
}

#[test]
fn a_needle_that_leaves_its_limits_after_a_stop_is_stopped_again() {
    let mut bench = Bench::enabled();
    bench.post.state = State { operating: Operating::Fault, present: Cause::ForceStale.into(), ..State::default() };
    bench.posts();
    assert_eq!(bench.sent(), []);
    bench.robot.velocity_mm_s = 100.0;
    bench.says();
    assert_eq!(bench.sent(), [STOP]);
    assert_eq!(bench.trip(), (1, Cause::Overspeed.into()));
    bench.says();
    assert_eq!(bench.sent(), []);
    assert_eq!(bench.trip().0, 1);
}

#[test]
fn without_a_guard_nothing_is_decided() {
    let mut bench = Bench::new();
    bench.supervisor.tick(bench.now_ns);
    bench.robot.depth_mm = 1e9;
    bench.says();
    assert!(bench.passes(Kind::Insert) && bench.passes(Kind::Stop));
    assert_eq!(bench.sent_within(500, |_| ()), []);
    assert_eq!(bench.supervisor.causes(bench.now_ns), Causes::NONE);
}

#[test]
fn another_session_begins_without_guard_and_keeps_the_count_of_trips() {
    let mut bench = Bench::enabled();
    bench.robot.depth_mm = 200.0;
    bench.says();
    bench.sent();
    let session = Session::new(8, SessionLimits::default(), None, bench.now_ns);
    bench.supervisor.begin(session, bench.now_ns);
    assert_eq!(bench.trip(), (1, Cause::DepthExceeded.into()));
    assert_eq!(bench.sent_within(100, |_| ()), []);
    assert!(bench.passes(Kind::Insert));
}

#[test]
fn a_session_that_the_robot_has_ended_is_a_fault() {
    let mut bench = Bench::enabled();
    let answer = bench.robot.answer(5, Kind::Insert as u8, 2, 0, bench.now_ns);
    bench.supervisor.take(&answer, bench.now_ns);
    assert_eq!(bench.sent(), [STOP]);
    assert_eq!(bench.trip(), (1, Cause::StageFault.into()));
}

#[test]
fn a_goodbye_ends_heartbeats_and_stops() {
    let mut bench = Bench::enabled();
    bench.robot.depth_mm = 200.0;
    bench.says();
    bench.sent();
    assert!(bench.passes(Kind::Goodbye));
    assert_eq!(bench.sent_within(100, |_| ()), []);
}

#[test]
fn a_heartbeat_has_no_number_and_a_deadline_of_the_silence_that_was_asked_for() {
    let mut bench = Bench::enabled();
    bench.now_ns += 5 * MS;
    let mut bytes = [0; 128];
    assert!(bench.supervisor.act(bench.now_ns, &mut bytes) > 0);
    assert_eq!((bytes[5], &bytes[36..40]), (ALIVE, &[0; 4][..]));
    assert_eq!(bytes[40..48], ((bench.now_ns + 30 * MS) as u64).to_le_bytes());
}

#[test]
fn a_stop_has_a_number_and_no_deadline() {
    let mut bench = Bench::enabled();
    bench.robot.depth_mm = 200.0;
    bench.says();
    let mut bytes = [0; 128];
    assert!(bench.supervisor.act(bench.now_ns, &mut bytes) > 0);
    assert_eq!((bytes[5], &bytes[36..40], &bytes[40..48]), (STOP, &[1, 0, 0, 0][..], &[0; 8][..]));
}
