//! Frames of a serial line: what is damaged is dropped, and nothing else.
#![cfg(feature = "robot")]

mod robot;

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use needleplan_guard::datagram::{Kind, Received, SessionLimits, decode, is_sound};
use needleplan_guard::line::{LONGEST_CARRIED, LONGEST_FRAME, LineQueue, Unframer, frame};
use needleplan_guard::session::{Message, Session};
use proptest::collection::vec;
use proptest::prelude::*;
use robot::Robot;

const MS: i64 = 1_000_000;

fn framed(sender: u8, datagram: &[u8]) -> Vec<u8> {
    let mut bytes = [0; LONGEST_FRAME];
    let size = frame(sender, datagram, &mut bytes);
    bytes[..size].to_vec()
}

fn found(line: &[u8]) -> (Vec<(u8, Vec<u8>)>, u64) {
    let mut unframer = Unframer::default();
    let mut frames = Vec::new();
    for byte in line {
        frames.extend(unframer.push(*byte).map(|(sender, datagram)| (sender, datagram.to_vec())));
    }
    (frames, unframer.damaged)
}

fn datagrams() -> impl Strategy<Value = Vec<u8>> {
    let mostly_zeros = prop_oneof![Just(0), any::<u8>()];
    vec(mostly_zeros, 0..=LONGEST_CARRIED)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn frames_come_back_and_only_their_ends_are_0(all in vec((any::<u8>(), datagrams()), 1..4)) {
        let line: Vec<u8> = all.iter().flat_map(|(sender, datagram)| framed(*sender, datagram)).collect();
        prop_assert_eq!(found(&line), (all.clone(), 0));
        for (sender, datagram) in all {
            let bytes = framed(sender, &datagram);
            let inside = &bytes[1..bytes.len() - 1];
            prop_assert_eq!((bytes.len(), inside.contains(&0)), (datagram.len() + 5, false));
        }
    }

    /// Noise, lost bytes and a cut frame before it do not hurt a frame: it begins with a byte 0.
    #[test]
    fn a_frame_after_noise_arrives(noise in vec(any::<u8>(), 0..400), sender in any::<u8>(), datagram in datagrams()) {
        let line = [noise, framed(sender, &datagram)].concat();
        prop_assert_eq!(found(&line).0.pop(), Some((sender, datagram)));
    }

    /// A frame in which one byte is lost, changed or added never gives another sound datagram, nor another sender.
    #[test]
    fn a_damaged_frame_gives_nothing(sender in any::<u8>(), at in 0..77_usize, way in 0..3, byte in any::<u8>()) {
        let datagram = Robot { session: 0, number: 9, ..Robot::default() }.compact(7);
        let mut line = framed(sender, &datagram);
        prop_assert_eq!(line.len(), 77);
        match way {
            0 => { line.remove(at); }
            1 => line[at] = byte,
            _ => line.insert(at, byte),
        }
        for (other, bytes) in found(&line).0 {
            prop_assert!((other == sender && bytes == datagram) || !is_sound(&bytes));
        }
    }
}

/// 4000 frames, of which half are damaged, with noise between them.
fn disturbed_line() -> Vec<u8> {
    let (mut line, mut random) = (Vec::new(), 1_u64);
    let mut draw = |below: u64| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 33) % below
    };
    for _ in 0..4000 {
        let size = draw(LONGEST_CARRIED as u64 + 1);
        let datagram: Vec<u8> = (0..size).map(|_| if draw(3) == 0 { 0 } else { draw(256) as u8 }).collect();
        let mut bytes = framed(draw(256) as u8, &datagram);
        match draw(6) {
            0 => bytes[draw(size + 5) as usize] = draw(256) as u8,
            1 => bytes.truncate(draw(size + 5) as usize),
            2 => bytes.extend((0..draw(200)).map(|_| draw(256) as u8)),
            _ => (),
        }
        line.extend(bytes);
    }
    line
}

#[test]
fn the_c_header_finds_the_same_frames_and_writes_them() {
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".into());
    let header = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/reference");
    if Command::new(&compiler).arg("--version").output().is_err() || !header.exists() {
        eprintln!("skipped: there is no C compiler, or the crate stands alone");
        return;
    }
    let (here, program) =
        (Path::new(env!("CARGO_MANIFEST_DIR")), Path::new(env!("CARGO_TARGET_TMPDIR")).join("unframe"));
    let mut command = Command::new(&compiler);
    command.args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-I"]);
    command.arg(header).arg(here.join("tests/c/unframe.c")).arg("-o").arg(&program);
    assert!(command.status().unwrap().success());
    let line = disturbed_line();
    let mut filter = Command::new(&program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let (mut input, bytes) = (filter.stdin.take().unwrap(), line.clone());
    let writing = std::thread::spawn(move || input.write_all(&bytes).unwrap());
    let written = filter.wait_with_output().unwrap().stdout;
    writing.join().unwrap();
    // C tells an empty datagram from no frame by its size, and drops it.
    let frames: Vec<_> = found(&line).0.into_iter().filter(|(_, datagram)| !datagram.is_empty()).collect();
    assert!((2500..3900).contains(&frames.len()));
    let expected: Vec<u8> = frames.iter().flat_map(|(sender, datagram)| framed(*sender, datagram)).collect();
    assert_eq!(written, expected);
}

#[test]
fn what_is_too_long_or_too_short_is_no_frame() {
    assert_eq!(framed(1, &[1; LONGEST_CARRIED + 1]), []);
    assert_eq!(found(&framed(1, &[1; LONGEST_CARRIED])), (vec![(1, vec![1; LONGEST_CARRIED])], 0));
    let too_long = [vec![0, LONGEST_CARRIED as u8 + 4, 5, 250], vec![1; LONGEST_CARRIED + 1], vec![0]].concat();
    assert_eq!(found(&too_long), (vec![], 1));
    assert_eq!(found(&[0, 0, 0]), (vec![], 0));
    assert_eq!(found(&[0, 2, 5, 0]), (vec![], 1)); // only a sender
    assert_eq!(found(&[0, 3, 5, 5, 0]), (vec![], 1)); // without its complement
    assert_eq!(found(&[0, 3, 5, 250, 0]), (vec![(5, vec![])], 0));
    assert_eq!(
        found(&[[1; 3 * LONGEST_FRAME].to_vec(), vec![0], framed(3, b"a")].concat()),
        (vec![(3, b"a".to_vec())], 1)
    );
}

#[test]
fn a_compact_status_says_what_a_status_says() {
    for version in [2, 3] {
        let mut robot = Robot { version, session: 7, number: 5, depth_mm: 12.34, flags: 1, ..Robot::default() };
        robot.velocity_mm_s = -5.25;
        let Received::Status(status) = decode(&robot.status(9), None) else { panic!() };
        let Received::Status(compact) = decode(&robot.compact(9), None) else { panic!() };
        assert!((compact.depth_mm - status.depth_mm).abs() < 1e-6);
        assert_eq!((compact.velocity_mm_s, compact.roll_rad), (-5.25, 0.0));
        assert_eq!((compact.faults, compact.state, compact.flags, compact.overruns, compact.missed), (9, 1, 1, 11, 13));
        assert_eq!((compact.head.number, robot.compact(9).len()), (5, 72));
        robot.flags = 8;
        assert_eq!(decode(&robot.compact(9), None), Received::Malformed);
    }
    let mut robot = Robot { session: 7, key: Some((b"sixteen bytes or more".to_vec(), 0)), ..Robot::default() };
    let mut session = Session::new(7, SessionLimits::default(), None, 0);
    assert!(matches!(session.take(&robot.compact(9), 9), Message::Status(..)));
    assert_eq!(robot.compact(9).len(), 88);
}

fn command(kind: Kind) -> Vec<u8> {
    Robot::default().datagram(kind as u8, 1, &[0; 28], 0)
}

fn leaving(queue: &mut LineQueue, now_ns: i64) -> Option<(u8, u8)> {
    let mut bytes = [0; LONGEST_FRAME];
    let size = queue.take(now_ns, &mut bytes);
    found(&bytes[..size]).0.pop().map(|(sender, datagram)| (sender, datagram[5]))
}

#[test]
fn datagrams_leave_one_after_the_other_as_the_line_is_free() {
    let mut queue = LineQueue::new(460_800);
    assert_eq!((queue.wait_ns(0), leaving(&mut queue, 0)), (None, None));
    for sender in [1, 2] {
        queue.put(sender, &command(Kind::Alive));
    }
    assert_eq!(queue.wait_ns(5), Some(0));
    assert_eq!(leaving(&mut queue, 5), Some((1, Kind::Alive as u8)));
    let took_ns = 770 * 1_000 * MS / 460_800; // 77 bytes of 10 bits
    assert_eq!((leaving(&mut queue, 5), queue.wait_ns(5)), (None, Some(took_ns)));
    assert_eq!(leaving(&mut queue, 4 + took_ns), None);
    assert_eq!(leaving(&mut queue, 5 + took_ns), Some((2, Kind::Alive as u8)));
    assert_eq!((queue.wait_ns(0), queue.dropped), (None, 0));
}

#[test]
fn a_stop_overtakes_all_but_stops_and_a_full_queue_drops_its_oldest() {
    let mut queue = LineQueue::new(0);
    queue.put(1, &command(Kind::Stop));
    for _ in 0..3 {
        queue.put(2, &command(Kind::Insert));
    }
    queue.put(3, &command(Kind::Stop));
    queue.put(4, &[7; LONGEST_CARRIED + 1]);
    assert_eq!(queue.dropped, 4);
    assert_eq!(leaving(&mut queue, 0), Some((1, Kind::Stop as u8)));
    assert_eq!(leaving(&mut queue, i64::MAX - 1), Some((3, Kind::Stop as u8)));
    let mut queue = LineQueue::new(460_800);
    for sender in 0..10 {
        queue.put(sender, &command(Kind::Alive));
    }
    assert_eq!((leaving(&mut queue, 0), queue.dropped), (Some((2, Kind::Alive as u8)), 2));
    // No flood discards a STOP.
    let mut queue = LineQueue::new(460_800);
    queue.put(1, &command(Kind::Stop));
    for sender in 2..40 {
        queue.put(sender, &command(Kind::Alive));
    }
    assert_eq!((leaving(&mut queue, 0), queue.dropped), (Some((1, Kind::Stop as u8)), 31));
    let mut queue = LineQueue::new(460_800);
    for sender in 0..9 {
        queue.put(sender, &command(Kind::Stop));
    }
    queue.put(99, &command(Kind::Alive));
    for sender in 1..9 {
        assert_eq!(leaving(&mut queue, i64::from(sender) * 1_000 * MS), Some((sender, Kind::Stop as u8)));
    }
    assert_eq!((queue.wait_ns(0), queue.dropped), (None, 2));
}
