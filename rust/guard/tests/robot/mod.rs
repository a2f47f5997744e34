//! The bytes that a robot sends, written by hand from docs/reference/robot-protocol.md.
#![allow(dead_code)]

pub mod bench;

use needleplan_guard::datagram::crc32;
use needleplan_guard::hmac::Key;

/// What the robot says in its next status.
#[derive(Clone)]
pub struct Robot {
    pub version: u8,
    pub session: u32,
    pub sequence: u32,
    pub number: u32,
    pub depth_mm: f64,
    pub velocity_mm_s: f64,
    pub roll_rad: f64,
    pub state: u8,
    pub flags: u8,
    /// How long ago a datagram was sent when it arrives.
    pub late_ns: i64,
    pub echo_ns: u64,
    pub held_us: u32,
    pub key: Option<(Vec<u8>, u64)>,
}

impl Default for Robot {
    fn default() -> Robot {
        Robot {
            version: 3,
            session: 0,
            sequence: 0,
            number: 0,
            depth_mm: 0.0,
            velocity_mm_s: 0.0,
            roll_rad: 0.0,
            state: 1,
            flags: 2,
            late_ns: 0,
            echo_ns: 0,
            held_us: 0,
            key: None,
        }
    }
}

impl Robot {
    pub fn status(&mut self, now_ns: i64) -> Vec<u8> {
        let mut body = Vec::new();
        for value in [self.depth_mm, self.velocity_mm_s, self.roll_rad, 0.0] {
            body.extend(value.to_le_bytes());
        }
        body.extend(9u32.to_le_bytes());
        body.extend([self.state, self.flags]);
        body.extend(11u16.to_le_bytes());
        body.extend(13u32.to_le_bytes());
        self.datagram(0x80, self.number, &body, now_ns)
    }

    /// The status of a serial line.
    pub fn compact(&mut self, now_ns: i64) -> Vec<u8> {
        let mut body = Vec::new();
        for value in [self.depth_mm, self.velocity_mm_s, self.roll_rad, 0.0] {
            body.extend((value as f32).to_le_bytes());
        }
        body.extend(9u32.to_le_bytes());
        body.extend([self.state, self.flags, 11, 0, 13, 0, 0, 0]);
        self.datagram(0x82, self.number, &body, now_ns)
    }

    pub fn answer(&mut self, number: u32, asked: u8, result: u16, nonce: u64, now_ns: i64) -> Vec<u8> {
        let mut body = nonce.to_le_bytes().to_vec();
        body.extend([asked, self.state]);
        body.extend(result.to_le_bytes());
        self.datagram(0x81, number, &body, now_ns)
    }

    pub fn datagram(&mut self, kind: u8, number: u32, body: &[u8], now_ns: i64) -> Vec<u8> {
        self.sequence = self.sequence.wrapping_add(1);
        let size = 40 + body.len() + self.key.as_ref().map_or(0, |_| 16) + 4;
        let mut bytes = b"NPLR".to_vec();
        bytes.extend([self.version, kind]);
        bytes.extend((size as u16).to_le_bytes());
        bytes.extend(self.session.to_le_bytes());
        bytes.extend(self.sequence.to_le_bytes());
        bytes.extend(((now_ns - self.late_ns) as u64).to_le_bytes());
        bytes.extend(self.echo_ns.to_le_bytes());
        bytes.extend(self.held_us.to_le_bytes());
        bytes.extend(number.to_le_bytes());
        bytes.extend(body);
        if let Some((key, nonce)) = &self.key {
            let tag = Key::new(key).digest(&nonce.to_le_bytes(), &bytes);
            bytes.extend(&tag[..16]);
        }
        let crc = crc32(&bytes);
        bytes.extend(crc.to_le_bytes());
        bytes
    }
}
