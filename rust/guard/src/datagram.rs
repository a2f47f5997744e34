//! The datagrams of the robot protocol as a controller sends and receives them (docs/reference/robot-protocol.md).

use crate::hmac::{Seal, TAG};

/// Version of the protocol that a controller speaks, and the oldest that it understands.
pub const VERSION: u8 = 3;
/// See [`VERSION`].
pub const OLDEST_VERSION: u8 = 2;
/// Bytes of the longest datagram.
pub const LONGEST: usize = 128;
/// Results of commands have numbers below this one.
pub const RESULTS: u16 = 15;

const MAGIC: &[u8; 4] = b"NPLR";
const HEAD: usize = 40;
const CRC: usize = 4;
const STATUS: u8 = 0x80;
const COMPACT: u8 = 0x82;
const ANSWER: u8 = 0x81;

/// Kind of a datagram that a controller sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Kind {
    /// Begins a session.
    Hello = 1,
    /// Permits motions.
    Enable = 2,
    /// Moves to a depth.
    Insert = 3,
    /// Rotates to a roll.
    Rotate = 4,
    /// Stops both axes.
    Stop = 5,
    /// Heartbeat.
    Alive = 6,
    /// Ends a fault whose cause is gone.
    Reset = 7,
    /// Ends a session.
    Goodbye = 8,
    /// Declares that the zero is known.
    Home = 9,
    /// Declares that the zero is lost.
    Unhome = 10,
}

impl Kind {
    /// All kinds, by their numbers less one.
    pub const ALL: [Kind; 10] = [
        Kind::Hello,
        Kind::Enable,
        Kind::Insert,
        Kind::Rotate,
        Kind::Stop,
        Kind::Alive,
        Kind::Reset,
        Kind::Goodbye,
        Kind::Home,
        Kind::Unhome,
    ];

    /// Whether a datagram of this kind can make the needle move.
    #[must_use]
    pub const fn is_motion(self) -> bool {
        matches!(self, Kind::Insert | Kind::Rotate)
    }
}

/// Fields at the start of every datagram; see `Head` of the Python package.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Head {
    /// Version of the protocol.
    pub version: u8,
    /// Session.
    pub session: u32,
    /// Number of the datagram.
    pub sequence: u32,
    /// Time of sending (ns) on the clock of the sender.
    pub sent_ns: u64,
    /// `sent_ns` of the last datagram of the other side; 0 before the first.
    pub echo_ns: u64,
    /// Time (us) from the arrival of that datagram.
    pub held_us: u32,
    /// Number of the command: that is sent, that is answered, or that was accepted last.
    pub number: u32,
}

/// Limits of the motions of a session, and its silence (us), as HELLO asks for them; 0: those of the robot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SessionLimits {
    /// Least depth, most depth, speed of insertion, roll, speed of rotation (mm, rad, s).
    pub numbers: [f64; 5],
    /// Time without a datagram after which a robot that moves stops (us).
    pub silence_us: u32,
    /// Longest time from the present to the deadline of a motion (us).
    pub valid_us: u32,
}

/// What a datagram says after its head.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Body {
    /// HELLO.
    Hello(SessionLimits),
    /// Any other datagram of a controller.
    Command {
        /// Kind, other than HELLO.
        kind: Kind,
        /// Latest time of execution (ns) on the clock of the robot.
        deadline_ns: u64,
        /// Depth (mm) or roll (rad).
        target: f64,
        /// Speed (mm/s or rad/s).
        speed: f64,
        /// As in [`SessionLimits`].
        silence_us: u32,
    },
}

/// State of the robot, sent 1000 times per second; on a serial line, with numbers of 4 bytes, at least 200 times.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Status {
    /// Head; `number` is that of the last accepted command.
    pub head: Head,
    /// Depth (mm).
    pub depth_mm: f64,
    /// Velocity (mm/s).
    pub velocity_mm_s: f64,
    /// Roll (rad).
    pub roll_rad: f64,
    /// Velocity of the roll (rad/s).
    pub velocity_rad_s: f64,
    /// Bits of the causes of a stop.
    pub faults: u32,
    /// 0 disabled, 1 enabled, 3 fault.
    pub state: u8,
    /// Bits: 1 moving, 2 homed, 4 standing.
    pub flags: u8,
    /// Late ticks of the servo.
    pub overruns: u16,
    /// Datagrams of the controller that were lost.
    pub missed: u32,
}

impl Status {
    /// Number of the state FAULT.
    pub const FAULT: u8 = 3;

    /// Whether an axis carries out a command.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.flags & 1 != 0
    }

    /// Whether both axes have stood for 50 ms by their measured positions; in version 2, whether none moves.
    #[must_use]
    pub fn is_standing(&self) -> bool {
        if self.head.version < VERSION { !self.is_moving() } else { self.flags & 4 != 0 }
    }

    /// Whether depth, velocity and roll are numbers.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.depth_mm.is_finite() && self.velocity_mm_s.is_finite() && self.roll_rad.is_finite()
    }
}

/// The answer of the robot to a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Answer {
    /// Head; `number` is that of the command.
    pub head: Head,
    /// Random number of the session in the answer to HELLO, else 0.
    pub nonce: u64,
    /// Kind of the command.
    pub asked: u8,
    /// State of the robot, as in [`Status`].
    pub state: u8,
    /// Result; 0: accepted.
    pub result: u16,
}

/// A datagram of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Received {
    /// A status.
    Status(Status),
    /// An answer.
    Answer(Answer),
    /// A datagram of a controller.
    Foreign,
    /// An undamaged datagram of another version, and its kind.
    OtherVersion(u8, u8),
    /// A damaged datagram, or one of another protocol.
    Malformed,
    /// An undamaged datagram without the right tag.
    NotAuthentic,
}

const fn crc_table() -> [u32; 256] {
    let (mut table, mut index) = ([0; 256], 0);
    while index < 256 {
        let (mut value, mut bit) = (index as u32, 0);
        while bit < 8 {
            value = if value & 1 == 1 { value >> 1 ^ 0xEDB8_8320 } else { value >> 1 };
            bit += 1;
        }
        table[index] = value;
        index += 1;
    }
    table
}

/// CRC-32 of zlib and Ethernet.
#[must_use]
pub fn crc32(bytes: &[u8]) -> u32 {
    const TABLE: [u32; 256] = crc_table();
    !bytes.iter().fold(!0, |crc, byte| crc >> 8 ^ TABLE[usize::from(crc as u8 ^ byte)])
}

/// Bytes that are written or read one field after the other.
struct Fields<'a> {
    bytes: &'a mut [u8; LONGEST],
    size: usize,
}

impl Fields<'_> {
    fn put(&mut self, field: &[u8]) {
        self.bytes[self.size..self.size + field.len()].copy_from_slice(field);
        self.size += field.len();
    }
}

/// Write a datagram of a controller, with the tag of `seal` if there is one, and return its size. HELLO is sealed
/// without the nonce.
pub fn encode(head: &Head, body: &Body, seal: Option<&Seal>, bytes: &mut [u8; LONGEST]) -> usize {
    let (kind, size) = match body {
        Body::Hello(_) => (Kind::Hello, 52),
        Body::Command { kind, .. } => (*kind, 28),
    };
    let size = HEAD + size + if seal.is_some() { TAG } else { 0 } + CRC;
    let mut fields = Fields { bytes, size: 0 };
    fields.put(MAGIC);
    fields.put(&[head.version, kind as u8]);
    fields.put(&(size as u16).to_le_bytes());
    fields.put(&head.session.to_le_bytes());
    fields.put(&head.sequence.to_le_bytes());
    fields.put(&head.sent_ns.to_le_bytes());
    fields.put(&head.echo_ns.to_le_bytes());
    fields.put(&head.held_us.to_le_bytes());
    fields.put(&head.number.to_le_bytes());
    match *body {
        Body::Hello(limits) => {
            limits.numbers.iter().for_each(|number| fields.put(&number.to_le_bytes()));
            fields.put(&limits.silence_us.to_le_bytes());
            fields.put(&limits.valid_us.to_le_bytes());
            fields.put(&[0; 4]);
        }
        Body::Command { deadline_ns, target, speed, silence_us, .. } => {
            fields.put(&deadline_ns.to_le_bytes());
            fields.put(&target.to_le_bytes());
            fields.put(&speed.to_le_bytes());
            fields.put(&silence_us.to_le_bytes());
        }
    }
    if let Some(seal) = seal {
        let nonce = if kind == Kind::Hello { 0 } else { seal.nonce };
        let tag = seal.tag(nonce, &fields.bytes[..fields.size]);
        fields.put(&tag);
    }
    let crc = crc32(&fields.bytes[..fields.size]);
    fields.put(&crc.to_le_bytes());
    fields.size
}

fn at<const N: usize>(bytes: &[u8], place: usize) -> [u8; N] {
    let mut field = [0; N];
    field.copy_from_slice(&bytes[place..place + N]);
    field
}

fn number(bytes: &[u8], place: usize) -> u32 {
    u32::from_le_bytes(at(bytes, place))
}

fn long(bytes: &[u8], place: usize) -> u64 {
    u64::from_le_bytes(at(bytes, place))
}

fn float(bytes: &[u8], place: usize) -> f64 {
    f64::from_le_bytes(at(bytes, place))
}

fn single(bytes: &[u8], place: usize) -> f64 {
    f64::from(f32::from_le_bytes(at(bytes, place)))
}

fn short(bytes: &[u8], place: usize) -> u16 {
    u16::from_le_bytes(at(bytes, place))
}

/// Whether these are the bytes of an undamaged datagram of any version.
#[must_use]
pub fn is_sound(datagram: &[u8]) -> bool {
    let signed = datagram.len().saturating_sub(CRC);
    signed >= 6 && datagram.starts_with(MAGIC) && crc32(&datagram[..signed]) == number(datagram, signed)
}

/// Read a datagram. With a `seal`, its tag must be that of the session; an answer may have that of the nonce 0.
#[must_use]
pub fn decode(datagram: &[u8], seal: Option<&Seal>) -> Received {
    if !is_sound(datagram) {
        return Received::Malformed;
    }
    let signed = datagram.len() - CRC;
    let (version, kind) = (datagram[4], datagram[5]);
    if !(OLDEST_VERSION..=VERSION).contains(&version) {
        return Received::OtherVersion(version, kind);
    }
    let is_new = kind == Kind::Home as u8 || kind == Kind::Unhome as u8;
    let body = match kind {
        STATUS => 44,
        COMPACT => 28,
        ANSWER => 12,
        1 => 52,
        2..=10 if version == VERSION || !is_new => 28,
        _ => return Received::Malformed,
    };
    let end = HEAD + body;
    let sizes = [end + CRC, end + TAG + CRC];
    if !sizes.contains(&datagram.len()) || usize::from(short(datagram, 6)) != datagram.len() {
        return Received::Malformed;
    }
    if let Some(seal) = seal {
        let (begin, tag) = (&datagram[..end], &datagram[end..signed]);
        if !(seal.is_tag(seal.nonce, begin, tag) || kind == ANSWER && seal.is_tag(0, begin, tag)) {
            return Received::NotAuthentic;
        }
    }
    let head = Head {
        version,
        session: number(datagram, 8),
        sequence: number(datagram, 12),
        sent_ns: long(datagram, 16),
        echo_ns: long(datagram, 24),
        held_us: number(datagram, 32),
        number: number(datagram, 36),
    };
    match kind {
        STATUS => status(head, core::array::from_fn(|at| float(datagram, HEAD + 8 * at)), &datagram[HEAD + 32..end]),
        COMPACT => status(head, core::array::from_fn(|at| single(datagram, HEAD + 4 * at)), &datagram[HEAD + 16..end]),
        ANSWER => answer(head, &datagram[HEAD..end]),
        _ => Received::Foreign,
    }
}

fn is_state(state: u8) -> bool {
    matches!(state, 0 | 1 | Status::FAULT)
}

fn status(head: Head, [depth_mm, velocity_mm_s, roll_rad, velocity_rad_s]: [f64; 4], rest: &[u8]) -> Received {
    let status = Status {
        head,
        depth_mm,
        velocity_mm_s,
        roll_rad,
        velocity_rad_s,
        faults: number(rest, 0),
        state: rest[4],
        flags: rest[5],
        overruns: short(rest, 6),
        missed: number(rest, 8),
    };
    let most = if head.version < VERSION { 1 } else { 7 };
    if is_state(status.state) && status.flags <= most { Received::Status(status) } else { Received::Malformed }
}

fn answer(head: Head, body: &[u8]) -> Received {
    let answer = Answer { head, nonce: long(body, 0), asked: body[8], state: body[9], result: short(body, 10) };
    if is_state(answer.state) && answer.result < RESULTS { Received::Answer(answer) } else { Received::Malformed }
}
