//! The session of a controller with a robot: numbers of its datagrams, the clock of the robot, and what was received.

use crate::Nanoseconds;
use crate::datagram::{
    Answer, Body, Head, Kind, LONGEST, OLDEST_VERSION, Received, SessionLimits, Status, VERSION, decode, encode,
};
use crate::hmac::Seal;

/// Length of a window of [`RobotClock`], which uses the present and the previous window.
const WINDOW_NS: Nanoseconds = 5_000_000_000;
/// Numbers that are ahead by less than this are later.
const HALF: u32 = 1 << 31;
/// Results of commands: the command was accepted; the robot speaks another version.
const ACCEPTED: u16 = 0;
const WRONG_VERSION: u16 = 3;
/// Results that mean that the robot no longer obeys this session.
const GONE: [u16; 2] = [1, 2];

/// Whether a number is later than another one, with wrap-around.
#[must_use]
pub fn is_later(number: u32, than: u32) -> bool {
    (1..HALF).contains(&number.wrapping_sub(than))
}

/// Lower bound of the present time on the robot's clock, and the round-trip time of a datagram.
///
/// A datagram contains the robot's time of sending. The unknown transmission time is taken as zero, so the bound is too
/// low by the transmission time. The datagram with the shortest transmission in the last 5 to 10 s is used. Older
/// datagrams are not used, because the two clocks drift apart.
#[derive(Clone, Copy, Debug, Default)]
pub struct RobotClock {
    /// Last measured round-trip time (ns).
    pub round_trip_ns: Option<u64>,
    /// Longest measured round-trip time (ns).
    pub worst_round_trip_ns: u64,
    ahead_ns: Option<i64>,
    before_ns: Option<i64>,
    since_ns: Nanoseconds,
    echo_ns: u64,
}

impl RobotClock {
    /// Update the bound and the round-trip time with the head of a datagram received at `now_ns`.
    pub fn see(&mut self, head: &Head, now_ns: Nanoseconds) {
        let ahead_ns = (head.sent_ns as i64).wrapping_sub(now_ns);
        if self.ahead_ns.is_none() || now_ns.saturating_sub(self.since_ns) > WINDOW_NS {
            self.before_ns = self.ahead_ns;
            self.ahead_ns = Some(ahead_ns);
            self.since_ns = now_ns;
        }
        self.ahead_ns = self.ahead_ns.max(Some(ahead_ns));
        if head.echo_ns > self.echo_ns {
            self.echo_ns = head.echo_ns;
            let passed_ns = (now_ns as u64).saturating_sub(head.echo_ns);
            let round_trip_ns = passed_ns.saturating_sub(1000 * u64::from(head.held_us));
            self.round_trip_ns = Some(round_trip_ns);
            self.worst_round_trip_ns = self.worst_round_trip_ns.max(round_trip_ns);
        }
    }

    /// Lower bound of the robot's time (ns) at the local time `now_ns`; 0 before the first datagram.
    #[must_use]
    pub fn at(&self, now_ns: Nanoseconds) -> u64 {
        self.ahead_ns.max(self.before_ns).map_or(0, |ahead_ns| now_ns.saturating_add(ahead_ns).max(1) as u64)
    }
}

/// Numbers of received and lost statuses and of discarded datagrams.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Statuses.
    pub received: u64,
    /// Statuses that did not arrive.
    pub lost: u64,
    /// Statuses that are not newer than the last one; they are discarded.
    pub repeated: u64,
    /// Damaged datagrams.
    pub malformed: u64,
    /// Datagrams of another session, or of another controller.
    pub foreign: u64,
    /// Datagrams that are not authenticated with the key of this session.
    pub not_authentic: u64,
}

/// What a received datagram means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Message {
    /// A new status, and the number of statuses that were lost before it.
    Status(Status, u32),
    /// An answer.
    Answer(Answer),
    /// The robot speaks another version, and the kind of its datagram.
    OtherVersion(u8, u8),
    /// Nothing: the datagram was counted and discarded.
    Discarded,
}

/// One session: what it sends, and what it has received.
#[derive(Clone)]
pub struct Session {
    /// Number of the session.
    pub id: u32,
    /// Version of the protocol in this session: that of the robot, if it is older.
    pub version: u8,
    /// Counts of datagrams.
    pub counts: Counts,
    /// The clock of the robot.
    pub clock: RobotClock,
    /// Time at which the last new status arrived.
    pub received_ns: Nanoseconds,
    /// Result that tells why the robot no longer obeys this session.
    pub lost_control: Option<u16>,
    /// Number of the last command that the robot has accepted, by the last status.
    pub accepted: Option<u32>,
    limits: SessionLimits,
    seal: Option<Seal>,
    sequence: u32,
    number: u32,
    last_sequence: Option<u32>,
    echo: (u64, Nanoseconds),
}

impl Session {
    /// A session that has not begun.
    #[must_use]
    pub fn new(id: u32, limits: SessionLimits, seal: Option<Seal>, now_ns: Nanoseconds) -> Session {
        Session {
            id,
            version: VERSION,
            counts: Counts::default(),
            clock: RobotClock::default(),
            received_ns: now_ns,
            lost_control: None,
            accepted: None,
            limits,
            seal,
            sequence: 0,
            number: 0,
            last_sequence: None,
            echo: (0, now_ns),
        }
    }

    /// The session, with datagrams and commands counted so far: counters may begin anywhere, and wrap.
    #[must_use]
    pub fn counting_from(self, count: u32) -> Session {
        Session { sequence: count, number: count, ..self }
    }

    /// Number of the last command.
    #[must_use]
    pub fn last_number(&self) -> u32 {
        self.number
    }

    /// Number of the next command; never 0.
    pub fn next_number(&mut self) -> u32 {
        self.number = self.number.wrapping_add(1).max(1);
        self.number
    }

    /// Latest time on the clock of the robot of a command that must arrive within a time.
    #[must_use]
    pub fn deadline_ns(&self, within_ns: Nanoseconds, now_ns: Nanoseconds) -> u64 {
        self.clock.at(now_ns).saturating_add(within_ns.max(0) as u64)
    }

    /// Time without a datagram after which a robot that moves stops (ns), as it was asked for.
    #[must_use]
    pub fn silence_ns(&self) -> Nanoseconds {
        1000 * i64::from(self.limits.silence_us)
    }

    /// Write a datagram and return its size.
    pub fn encode(
        &mut self,
        kind: Kind,
        number: u32,
        deadline_ns: u64,
        (target, speed): (f64, f64),
        now_ns: Nanoseconds,
        bytes: &mut [u8; LONGEST],
    ) -> usize {
        self.sequence = self.sequence.wrapping_add(1);
        let (echo_ns, received_ns) = self.echo;
        let held_us = now_ns.saturating_sub(received_ns).max(0) / 1000;
        let head = Head {
            version: self.version,
            session: self.id,
            sequence: self.sequence,
            sent_ns: now_ns as u64,
            echo_ns,
            held_us: if echo_ns == 0 { 0 } else { u32::try_from(held_us).unwrap_or(u32::MAX) },
            number,
        };
        let silence_us = self.limits.silence_us;
        let body = if kind == Kind::Hello {
            Body::Hello(self.limits)
        } else {
            Body::Command { kind, deadline_ns, target, speed, silence_us }
        };
        encode(&head, &body, self.seal.as_ref(), bytes)
    }

    /// Take a received datagram.
    pub fn take(&mut self, datagram: &[u8], now_ns: Nanoseconds) -> Message {
        match decode(datagram, self.seal.as_ref()) {
            Received::Status(status) if status.head.session == self.id => self.status(status, now_ns),
            Received::Answer(answer) if answer.result == WRONG_VERSION => {
                // HELLO is sent again in the older version of the robot.
                if self.accepted.is_none() {
                    self.version = self.version.min(answer.head.version).max(OLDEST_VERSION);
                }
                Message::Discarded
            }
            Received::Answer(answer) if answer.head.session == self.id => self.answer(answer, now_ns),
            Received::OtherVersion(version, kind) => Message::OtherVersion(version, kind),
            Received::Malformed => discarded(&mut self.counts.malformed),
            Received::NotAuthentic => discarded(&mut self.counts.not_authentic),
            Received::Status(_) | Received::Answer(_) | Received::Foreign => discarded(&mut self.counts.foreign),
        }
    }

    fn answer(&mut self, answer: Answer, now_ns: Nanoseconds) -> Message {
        self.clock.see(&answer.head, now_ns);
        let is_greeting = answer.asked == Kind::Hello as u8;
        if let Some(seal) = &mut self.seal
            && is_greeting
            && answer.result == ACCEPTED
        {
            seal.nonce = answer.nonce;
        }
        if GONE.contains(&answer.result) && !is_greeting {
            self.lost_control = Some(answer.result);
        }
        Message::Answer(answer)
    }

    fn status(&mut self, status: Status, now_ns: Nanoseconds) -> Message {
        self.clock.see(&status.head, now_ns);
        let sequence = status.head.sequence;
        let lost = match self.last_sequence {
            None => 0,
            Some(last) if is_later(sequence, last) => sequence.wrapping_sub(last) - 1,
            Some(_) => return discarded(&mut self.counts.repeated),
        };
        self.last_sequence = Some(sequence);
        self.counts.received += 1;
        self.counts.lost += u64::from(lost);
        self.received_ns = now_ns;
        self.echo = (status.head.sent_ns, now_ns);
        self.accepted = Some(status.head.number);
        Message::Status(status, lost)
    }
}

fn discarded(count: &mut u64) -> Message {
    *count += 1;
    Message::Discarded
}
