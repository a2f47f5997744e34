//! Datagrams and sessions, beside bytes that are written by hand.
#![cfg(feature = "robot")]

mod robot;

use needleplan_guard::datagram::{
    Answer, Body, Head, Kind, LONGEST, Received, SessionLimits, Status, crc32, decode, encode,
};
use needleplan_guard::hmac::{Key, Seal};
use needleplan_guard::session::{Counts, Message, Session, is_later};
use robot::Robot;

const KEY: &[u8] = b"sixteen bytes or more";

fn seal(nonce: u64) -> Seal {
    Seal { key: Key::new(KEY), nonce }
}

fn session() -> Session {
    Session::new(7, SessionLimits { silence_us: 30_000, ..SessionLimits::default() }, None, 0)
}

fn robot() -> Robot {
    Robot { session: 7, ..Robot::default() }
}

#[test]
fn the_checksum_is_that_of_zlib() {
    assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    assert_eq!(crc32(b""), 0);
}

#[test]
fn datagrams_have_their_bytes() {
    let head = Head {
        version: 3,
        session: 0x0403_0201,
        sequence: 0x0807_0605,
        sent_ns: 0x100F_0E0D_0C0B_0A09,
        echo_ns: 0x1817_1615_1413_1211,
        held_us: 0x1C1B_1A19,
        number: 0x201F_1E1D,
    };
    let mut bytes = [0; LONGEST];
    let body = Body::Command { kind: Kind::Insert, deadline_ns: 5, target: 1.5, speed: -2.5, silence_us: 9 };
    let size = encode(&head, &body, None, &mut bytes);
    assert_eq!(size, 72);
    assert_eq!(&bytes[..8], b"NPLR\x03\x03\x48\x00");
    assert_eq!(bytes[8..40], (1..=32).collect::<Vec<u8>>());
    assert_eq!(bytes[40..48], 5u64.to_le_bytes());
    assert_eq!(bytes[48..56], 1.5f64.to_le_bytes());
    assert_eq!(bytes[56..64], (-2.5f64).to_le_bytes());
    assert_eq!(bytes[64..68], 9u32.to_le_bytes());
    assert_eq!(bytes[68..72], crc32(&bytes[..68]).to_le_bytes());
    let limits = SessionLimits { numbers: [1.0, 2.0, 3.0, 4.0, 5.0], silence_us: 6, valid_us: 7 };
    let size = encode(&head, &Body::Hello(limits), None, &mut bytes);
    assert_eq!((size, bytes[5]), (96, 1));
    for (place, number) in [1.0, 2.0, 3.0, 4.0, 5.0f64].iter().enumerate() {
        assert_eq!(bytes[40 + 8 * place..48 + 8 * place], number.to_le_bytes());
    }
    assert_eq!(bytes[80..92], [6, 0, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(bytes[92..96], crc32(&bytes[..92]).to_le_bytes());
}

#[test]
fn a_sealed_datagram_has_the_tag_of_its_session() {
    let mut bytes = [0; LONGEST];
    for (body, nonce) in [
        (Body::Hello(SessionLimits::default()), 0u64),
        (Body::Command { kind: Kind::Stop, deadline_ns: 0, target: 0.0, speed: 0.0, silence_us: 0 }, 99),
    ] {
        let size = encode(&Head { version: 3, ..Head::default() }, &body, Some(&seal(99)), &mut bytes);
        assert_eq!(usize::from(bytes[6]), size);
        let tag = Key::new(KEY).digest(&nonce.to_le_bytes(), &bytes[..size - 20]);
        assert_eq!(bytes[size - 20..size - 4], tag[..16]);
    }
}

#[test]
fn a_status_has_its_fields() {
    let mut robot = Robot { depth_mm: 1.0, velocity_mm_s: 2.0, roll_rad: 3.0, number: 4, flags: 5, ..robot() };
    (robot.echo_ns, robot.held_us) = (6, 7);
    let Received::Status(status) = decode(&robot.status(8), None) else { panic!("no status") };
    let head = Head { version: 3, session: 7, sequence: 1, sent_ns: 8, echo_ns: 6, held_us: 7, number: 4 };
    let right = Status {
        head,
        depth_mm: 1.0,
        velocity_mm_s: 2.0,
        roll_rad: 3.0,
        velocity_rad_s: 0.0,
        faults: 9,
        state: 1,
        flags: 5,
        overruns: 11,
        missed: 13,
    };
    assert_eq!(status, right);
    assert!(status.is_moving() && status.is_standing() && status.is_finite());
    let moving = Status { flags: 1, ..right };
    assert!(moving.is_moving() && !moving.is_standing());
    for wrong in [
        Status { depth_mm: f64::NAN, ..right },
        Status { velocity_mm_s: f64::INFINITY, ..right },
        Status { roll_rad: f64::NAN, ..right },
    ] {
        assert!(!wrong.is_finite());
    }
}

#[test]
fn every_damaged_byte_is_found() {
    let datagram = robot().status(1);
    for place in 0..datagram.len() {
        for bit in 0..8 {
            let mut damaged = datagram.clone();
            damaged[place] ^= 1 << bit;
            assert_eq!(decode(&damaged, None), Received::Malformed);
        }
    }
    for size in 0..datagram.len() {
        assert_eq!(decode(&datagram[..size], None), Received::Malformed);
    }
}

#[test]
fn a_datagram_that_is_wrong_under_a_right_checksum_is_malformed() {
    let mut robot = robot();
    let bodies: [(u8, Vec<u8>); 6] = [
        (0x80, vec![0; 43]),
        (0x80, vec![0; 45]),
        (0x81, vec![0; 11]),
        (0x00, vec![0; 28]),
        (0x0B, vec![0; 28]),
        (0x83, vec![0; 44]),
    ];
    for (kind, body) in bodies {
        assert_eq!(decode(&robot.datagram(kind, 0, &body, 0), None), Received::Malformed);
    }
    assert_eq!(decode(&robot.datagram(0x05, 0, &[0; 28], 0), None), Received::Foreign);
    assert_eq!(decode(&robot.datagram(0x01, 0, &[0; 52], 0), None), Received::Foreign);
    assert_eq!(decode(&robot.datagram(0x09, 0, &[0; 28], 0), None), Received::Foreign);
    for (state, flags) in [(2, 0), (4, 0), (1, 8)] {
        (robot.state, robot.flags) = (state, flags);
        assert_eq!(decode(&robot.status(0), None), Received::Malformed);
    }
    (robot.state, robot.flags) = (1, 7);
    assert!(matches!(decode(&robot.status(0), None), Received::Status(_)));
    assert_eq!(decode(&robot.answer(1, 5, 15, 0, 0), None), Received::Malformed);
    assert!(matches!(decode(&robot.answer(1, 5, 14, 0, 0), None), Received::Answer(_)));
    robot.state = 2;
    assert_eq!(decode(&robot.answer(1, 5, 14, 0, 0), None), Received::Malformed);
}

#[test]
fn versions() {
    let mut robot = Robot { version: 2, flags: 1, ..robot() };
    let Received::Status(status) = decode(&robot.status(0), None) else { panic!("no status") };
    assert!(status.is_moving() && !status.is_standing());
    robot.flags = 2;
    assert_eq!(decode(&robot.status(0), None), Received::Malformed);
    assert_eq!(decode(&robot.datagram(0x09, 0, &[0; 28], 0), None), Received::Malformed);
    assert_eq!(decode(&robot.datagram(0x0A, 0, &[0; 28], 0), None), Received::Malformed);
    assert_eq!(decode(&robot.datagram(0x08, 0, &[0; 28], 0), None), Received::Foreign);
    for version in [0, 1, 4, 255] {
        robot.version = version;
        assert_eq!(decode(&robot.status(0), None), Received::OtherVersion(version, 0x80));
        assert_eq!(session().take(&robot.status(0), 0), Message::OtherVersion(version, 0x80));
    }
}

#[test]
fn the_shortest_datagram_of_another_version_is_recognised() {
    let mut datagram = b"NPLR\x09\x80".to_vec();
    datagram.extend(crc32(&datagram).to_le_bytes());
    assert_eq!(decode(&datagram, None), Received::OtherVersion(9, 0x80));
}

#[test]
fn with_a_key_only_its_datagrams_count_and_only_an_answer_without_the_nonce() {
    let sealed = |key: &[u8], nonce| Robot { key: Some((key.to_vec(), nonce)), ..robot() };
    let seal = seal(5);
    assert!(matches!(decode(&sealed(KEY, 5).status(0), Some(&seal)), Received::Status(_)));
    assert!(matches!(decode(&sealed(KEY, 5).answer(1, 5, 0, 0, 0), Some(&seal)), Received::Answer(_)));
    assert!(matches!(decode(&sealed(KEY, 0).answer(1, 5, 0, 0, 0), Some(&seal)), Received::Answer(_)));
    for stranger in [
        sealed(KEY, 0).status(0),
        sealed(KEY, 6).status(0),
        sealed(KEY, 6).answer(1, 5, 0, 0, 0),
        sealed(b"another key of bytes", 5).status(0),
        robot().status(0),
    ] {
        assert_eq!(decode(&stranger, Some(&seal)), Received::NotAuthentic);
    }
    // Without a key of its own, a controller ignores tags.
    assert!(matches!(decode(&sealed(KEY, 5).status(0), None), Received::Status(_)));
}

#[test]
fn the_nonce_is_that_of_the_accepted_greeting() {
    let limits = SessionLimits::default();
    let mut session = Session::new(7, limits, Some(seal(0)), 0);
    let mut robot = Robot { key: Some((KEY.to_vec(), 0)), ..robot() };
    for (asked, result) in [(1, 1), (5, 0)] {
        session.take(&robot.answer(1, asked, result, 55, 0), 0);
        assert!(matches!(session.take(&robot.answer(1, 1, 1, 0, 0), 0), Message::Answer(_)));
        robot.key = Some((KEY.to_vec(), 55));
        assert_eq!(session.take(&robot.status(0), 0), Message::Discarded);
        robot.key = Some((KEY.to_vec(), 0));
    }
    session.take(&robot.answer(1, 1, 0, 55, 0), 0);
    robot.key = Some((KEY.to_vec(), 55));
    assert!(matches!(session.take(&robot.status(0), 0), Message::Status(..)));
    assert_eq!(session.counts.not_authentic, 2);
}

#[test]
fn lost_repeated_and_foreign_statuses_are_counted() {
    let (mut session, mut robot) = (session(), robot());
    robot.sequence = u32::MAX - 2;
    let mut lost = |robot: &mut Robot, ahead: u32| {
        robot.sequence = robot.sequence.wrapping_add(ahead);
        match session.take(&robot.status(0), 0) {
            Message::Status(_, lost) => Some(lost),
            Message::Discarded => None,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(lost(&mut robot, 0), Some(0));
    assert_eq!(lost(&mut robot, 0), Some(0));
    assert_eq!(lost(&mut robot, 3), Some(3)); // over the end of the numbers
    assert_eq!(lost(&mut robot, u32::MAX), None); // the same again
    assert_eq!(lost(&mut robot, u32::MAX - 1), None); // one earlier
    assert_eq!(lost(&mut robot, 1), Some(0));
    robot.session = 8;
    assert_eq!(lost(&mut robot, 0), None);
    session.take(b"NPLR", 0);
    let right = Counts { received: 4, lost: 3, repeated: 2, malformed: 1, foreign: 1, not_authentic: 0 };
    assert_eq!(session.counts, right);
}

#[test]
fn later_numbers() {
    for (number, than, later) in [
        (1, 0, true),
        (0, 0, false),
        (0, 1, false),
        (0, u32::MAX, true),
        (u32::MAX, 0, false),
        (0x7FFF_FFFF, 0, true),
        (0x8000_0000, 0, false),
    ] {
        assert_eq!(is_later(number, than), later);
    }
}

#[test]
fn numbers_of_commands_skip_zero_and_datagrams_count_up() {
    let mut session = session();
    assert_eq!((session.last_number(), session.next_number(), session.last_number()), (0, 1, 1));
    let mut bytes = [0; LONGEST];
    for sequence in 1..4u32 {
        let size = session.encode(Kind::Alive, 0, 0, (0.0, 0.0), 0, &mut bytes);
        assert_eq!(bytes[12..16], sequence.to_le_bytes());
        assert_eq!(bytes[size - 8..size - 4], 30_000u32.to_le_bytes());
    }
    for _ in 0..3 {
        session.next_number();
    }
    assert_eq!(session.last_number(), 4);
}

#[test]
fn a_datagram_echoes_the_last_status() {
    let (mut session, mut robot) = (session(), robot());
    let mut bytes = [0; LONGEST];
    session.encode(Kind::Alive, 0, 0, (0.0, 0.0), 9_000_000, &mut bytes);
    assert_eq!(bytes[24..36], [0; 12]);
    robot.number = 3;
    session.take(&robot.status(77), 10_000_000);
    assert_eq!((session.received_ns, session.accepted), (10_000_000, Some(3)));
    session.encode(Kind::Alive, 0, 0, (0.0, 0.0), 12_500_000, &mut bytes);
    assert_eq!(bytes[16..24], 12_500_000u64.to_le_bytes());
    assert_eq!(bytes[24..32], 77u64.to_le_bytes());
    assert_eq!(bytes[32..36], 2_500u32.to_le_bytes());
}

#[test]
fn the_clock_of_the_robot_is_bounded_by_the_fastest_of_the_last_datagrams() {
    const S: i64 = 1_000_000_000;
    let (mut session, mut robot) = (session(), robot());
    assert_eq!(session.deadline_ns(5, 1), 5);
    let mut at = |session: &mut Session, now_ns: i64, ahead_ns: i64| {
        session.take(&robot.status(now_ns + ahead_ns), now_ns);
        session.clock.at(now_ns) as i64 - now_ns
    };
    assert_eq!(at(&mut session, S, 100), 100);
    assert_eq!(at(&mut session, 2 * S, 90), 100);
    assert_eq!(at(&mut session, 3 * S, 120), 120);
    // A window of 5 s, and the one before.
    assert_eq!(at(&mut session, 6 * S + 1, 50), 120);
    assert_eq!(at(&mut session, 11 * S + 1, 40), 120);
    assert_eq!(at(&mut session, 11 * S + 2, 40), 50);
    assert_eq!(session.deadline_ns(7, 12 * S), (12 * S + 57) as u64);
    assert_eq!(session.deadline_ns(-7, 12 * S), (12 * S + 50) as u64);
    assert_eq!(session.silence_ns(), 30_000_000);
}

#[test]
fn a_robot_whose_clock_is_behind_has_a_time() {
    let (mut session, mut robot) = (session(), robot());
    session.take(&robot.status(5), 1_000);
    assert_eq!(session.clock.at(1_003), 8);
    assert_eq!(session.clock.at(10), 1);
}

#[test]
fn the_round_trip_leaves_out_the_time_at_the_robot() {
    let (mut session, mut robot) = (session(), robot());
    session.take(&robot.status(1), 5_000);
    assert_eq!(session.clock.round_trip_ns, None);
    for (echo_ns, held_us, now_ns, last_ns, worst_ns) in [
        (1_000, 2, 10_000, 7_000, 7_000),
        (2_000, 3, 9_000, 4_000, 7_000),
        (2_000, 0, 99_000, 4_000, 7_000), // the same echo
        (20_000, 99, 30_000, 0, 7_000),
    ] {
        (robot.echo_ns, robot.held_us) = (echo_ns, held_us);
        session.take(&robot.status(1), now_ns);
        assert_eq!(session.clock.round_trip_ns, Some(last_ns));
        assert_eq!(session.clock.worst_round_trip_ns, worst_ns);
    }
}

#[test]
fn an_older_robot_is_spoken_to_in_its_version_before_its_first_status_only() {
    let (mut session, mut robot) = (session(), Robot { session: 0, version: 2, ..robot() });
    assert_eq!(session.take(&robot.answer(1, 1, 3, 0, 0), 0), Message::Discarded);
    assert_eq!(session.version, 2);
    let mut session = Session::new(7, SessionLimits::default(), None, 0);
    (robot.session, robot.flags) = (7, 0);
    session.take(&robot.status(0), 0);
    assert_eq!(session.take(&robot.answer(1, 1, 3, 0, 0), 0), Message::Discarded);
    assert_eq!(session.version, 3);
}

#[test]
fn control_is_lost_by_an_answer_to_a_command_and_not_by_one_to_hello() {
    for result in 0..15 {
        let (mut session, mut robot) = (session(), robot());
        session.take(&robot.answer(1, 1, result, 0, 0), 0);
        assert_eq!(session.lost_control, None);
        let message = session.take(&robot.answer(9, 3, result, 0, 0), 0);
        assert_eq!(session.lost_control, (result == 1 || result == 2).then_some(result));
        if result != 3 {
            let Message::Answer(Answer { head, asked, .. }) = message else { panic!("no answer") };
            assert_eq!((head.number, asked), (9, 3));
        }
        robot.session = 8;
        assert_eq!(session.take(&robot.answer(9, 3, result, 0, 0), 0), Message::Discarded);
    }
}
