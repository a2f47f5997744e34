//! A serial line to a robot: frames that carry datagrams, and the order in which waiting datagrams leave.
//!
//! A frame is a datagram behind the number of its sender, stuffed by COBS (Cheshire and Baker, "Consistent overhead byte
//! stuffing", IEEE/ACM Trans. Networking 7, 1999), between two bytes 0. After noise or a cut frame, the receiver is in
//! step again at the next byte 0.

use crate::Nanoseconds;
use crate::datagram::{Kind, LONGEST};

/// Bytes of the longest datagram that a frame carries: HELLO with a tag.
pub const LONGEST_CARRIED: usize = 112;
/// Number of the sender, and its complement: a damaged number must not pass for that of another sender.
const SENDER: usize = 2;
const LONGEST_CONTENT: usize = SENDER + LONGEST_CARRIED;
/// Bytes of the longest frame: one more for COBS, and two bytes 0.
pub const LONGEST_FRAME: usize = LONGEST_CONTENT + 3;
/// Datagrams that may wait at a time. At 460,800 baud, a full queue leaves within 20 ms.
const WAITING: usize = 8;
/// Bits on the line for each byte: start, 8 data bits, stop.
const BITS: i64 = 10;

/// Write the frame of a datagram and return its size; 0 if the datagram is too long.
pub fn frame(sender: u8, datagram: &[u8], bytes: &mut [u8; LONGEST_FRAME]) -> usize {
    if datagram.len() > LONGEST_CARRIED {
        return 0;
    }
    let (mut code, mut size) = (1, 2);
    bytes[0] = 0;
    for byte in [sender, !sender].iter().chain(datagram) {
        if *byte == 0 {
            bytes[code] = (size - code) as u8;
            code = size;
        } else {
            bytes[size] = *byte;
        }
        size += 1;
    }
    bytes[code] = (size - code) as u8;
    bytes[size] = 0;
    size + 1
}

/// Finds frames in the bytes of a line.
#[derive(Clone)]
pub struct Unframer {
    bytes: [u8; LONGEST_FRAME],
    size: usize,
    /// Number of contents between two bytes 0 that are not those of a frame.
    pub damaged: u64,
}

impl Default for Unframer {
    fn default() -> Unframer {
        Unframer { bytes: [0; LONGEST_FRAME], size: 0, damaged: 0 }
    }
}

impl Unframer {
    /// Take the next byte of the line; return the sender and the datagram of the frame that it ends.
    pub fn push(&mut self, byte: u8) -> Option<(u8, &[u8])> {
        if byte != 0 {
            if let Some(place) = self.bytes.get_mut(self.size) {
                *place = byte;
            }
            self.size = self.size.saturating_add(1);
            return None;
        }
        let size = core::mem::take(&mut self.size);
        if size == 0 {
            return None;
        }
        let content = self.unstuff(size).filter(|size| *size >= SENDER && self.bytes[0] == !self.bytes[1]);
        let Some(size) = content else {
            self.damaged += 1;
            return None;
        };
        Some((self.bytes[0], &self.bytes[SENDER..size]))
    }

    /// Undo COBS in place, and return the size of the content; None if it was not COBS.
    fn unstuff(&mut self, size: usize) -> Option<usize> {
        if size > LONGEST_CONTENT + 1 {
            return None;
        }
        let (mut read, mut written) = (0, 0);
        while read < size {
            let end = read + usize::from(self.bytes[read]);
            if end > size {
                return None;
            }
            if read > 0 {
                self.bytes[written] = 0;
                written += 1;
            }
            self.bytes.copy_within(read + 1..end, written);
            written += end - read - 1;
            read = end;
        }
        Some(written)
    }
}

/// Datagrams that wait for a line. They wait here, not in the operating system, so that a STOP overtakes them.
///
/// A STOP discards all that waits but other STOPs. If the queue is full, the oldest datagram is discarded that is no STOP.
/// A datagram that is lost is sent again by its sender, as on a network.
pub struct LineQueue {
    frames: [([u8; LONGEST_FRAME], usize, bool); WAITING],
    count: usize,
    baud: i64,
    /// Time at which all that was written has left.
    free_ns: Nanoseconds,
    /// Number of datagrams that were discarded.
    pub dropped: u64,
}

impl LineQueue {
    /// The queue of a line of `baud` bits per second.
    #[must_use]
    pub fn new(baud: u32) -> LineQueue {
        let frames = [([0; LONGEST_FRAME], 0, false); WAITING];
        LineQueue { frames, count: 0, baud: i64::from(baud.max(1)), free_ns: 0, dropped: 0 }
    }

    /// Let a datagram wait.
    pub fn put(&mut self, sender: u8, datagram: &[u8]) {
        let is_stop = datagram.get(5) == Some(&(Kind::Stop as u8));
        let mut bytes = [0; LONGEST_FRAME];
        let size = frame(sender, datagram, &mut bytes);
        if size == 0 {
            self.dropped += 1;
            return;
        }
        if is_stop {
            self.keep_stops();
        }
        if self.count == WAITING {
            self.dropped += 1;
            let oldest = self.frames.iter().position(|(_, _, is_stop)| !is_stop);
            match oldest {
                None if !is_stop => return,
                _ => self.remove(oldest.unwrap_or(0)),
            }
        }
        self.frames[self.count] = (bytes, size, is_stop);
        self.count += 1;
    }

    /// Write the next frame, and return its size; 0 if none waits, or the line is not free.
    pub fn take(&mut self, now_ns: Nanoseconds, bytes: &mut [u8; LONGEST_FRAME]) -> usize {
        if self.count == 0 || now_ns < self.free_ns {
            return 0;
        }
        let (frame, size, _) = self.frames[0];
        *bytes = frame;
        self.remove(0);
        self.free_ns = now_ns.saturating_add(size as i64 * BITS * 1_000_000_000 / self.baud);
        size
    }

    /// Time (ns) until a frame that waits may leave; None if none waits.
    #[must_use]
    pub fn wait_ns(&self, now_ns: Nanoseconds) -> Option<Nanoseconds> {
        (self.count > 0).then_some(self.free_ns.saturating_sub(now_ns).max(0))
    }

    fn remove(&mut self, place: usize) {
        self.frames.copy_within(place + 1..self.count, place);
        self.count -= 1;
    }

    fn keep_stops(&mut self) {
        let mut kept = 0;
        for place in 0..self.count {
            if self.frames[place].2 {
                self.frames[kept] = self.frames[place];
                kept += 1;
            }
        }
        self.dropped += (self.count - kept) as u64;
        self.count = kept;
    }
}

const _: () = assert!(LONGEST_CARRIED <= LONGEST && LONGEST_CONTENT < 254); // one code byte of COBS suffices
