//! HMAC-SHA256 (RFC 2104, FIPS 180-4), which authenticates the datagrams of a robot that has a key.

/// Bytes of a block of SHA-256.
const BLOCK: usize = 64;
/// Constants of the rounds: the fractions of the cube roots of the first primes.
const ROUNDS: [u32; 64] = [
    0x428a_2f98,
    0x7137_4491,
    0xb5c0_fbcf,
    0xe9b5_dba5,
    0x3956_c25b,
    0x59f1_11f1,
    0x923f_82a4,
    0xab1c_5ed5,
    0xd807_aa98,
    0x1283_5b01,
    0x2431_85be,
    0x550c_7dc3,
    0x72be_5d74,
    0x80de_b1fe,
    0x9bdc_06a7,
    0xc19b_f174,
    0xe49b_69c1,
    0xefbe_4786,
    0x0fc1_9dc6,
    0x240c_a1cc,
    0x2de9_2c6f,
    0x4a74_84aa,
    0x5cb0_a9dc,
    0x76f9_88da,
    0x983e_5152,
    0xa831_c66d,
    0xb003_27c8,
    0xbf59_7fc7,
    0xc6e0_0bf3,
    0xd5a7_9147,
    0x06ca_6351,
    0x1429_2967,
    0x27b7_0a85,
    0x2e1b_2138,
    0x4d2c_6dfc,
    0x5338_0d13,
    0x650a_7354,
    0x766a_0abb,
    0x81c2_c92e,
    0x9272_2c85,
    0xa2bf_e8a1,
    0xa81a_664b,
    0xc24b_8b70,
    0xc76c_51a3,
    0xd192_e819,
    0xd699_0624,
    0xf40e_3585,
    0x106a_a070,
    0x19a4_c116,
    0x1e37_6c08,
    0x2748_774c,
    0x34b0_bcb5,
    0x391c_0cb3,
    0x4ed8_aa4a,
    0x5b9c_ca4f,
    0x682e_6ff3,
    0x748f_82ee,
    0x78a5_636f,
    0x84c8_7814,
    0x8cc7_0208,
    0x90be_fffa,
    0xa450_6ceb,
    0xbef9_a3f7,
    0xc671_78f2,
];
/// First state: the fractions of the square roots of the first primes.
const BEGIN: [u32; 8] =
    [0x6a09_e667, 0xbb67_ae85, 0x3c6e_f372, 0xa54f_f53a, 0x510e_527f, 0x9b05_688c, 0x1f83_d9ab, 0x5be0_cd19];

/// A hash that is fed in pieces.
#[derive(Clone)]
struct Sha256 {
    state: [u32; 8],
    block: [u8; BLOCK],
    length: usize,
}

impl Sha256 {
    fn new() -> Sha256 {
        Sha256 { state: BEGIN, block: [0; BLOCK], length: 0 }
    }

    fn update(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.block[self.length % BLOCK] = *byte;
            self.length += 1;
            if self.length.is_multiple_of(BLOCK) {
                self.compress();
            }
        }
    }

    fn finish(mut self) -> [u8; 32] {
        let bits = (self.length as u64) * 8;
        self.update(&[0x80]);
        while self.length % BLOCK != BLOCK - 8 {
            self.update(&[0]);
        }
        self.update(&bits.to_be_bytes());
        let mut digest = [0; 32];
        for (bytes, word) in digest.chunks_exact_mut(4).zip(self.state) {
            bytes.copy_from_slice(&word.to_be_bytes());
        }
        digest
    }

    fn compress(&mut self) {
        let mut words = [0u32; 64];
        for (word, bytes) in words.iter_mut().zip(self.block.chunks_exact(4)) {
            *word = u32::from_be_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        }
        for t in 16..64 {
            let (early, late) = (words[t - 15], words[t - 2]);
            let small = early.rotate_right(7) ^ early.rotate_right(18) ^ (early >> 3);
            let large = late.rotate_right(17) ^ late.rotate_right(19) ^ (late >> 10);
            words[t] = words[t - 16].wrapping_add(small).wrapping_add(words[t - 7]).wrapping_add(large);
        }
        let [mut a, mut b, mut c, mut d, mut e, mut f, mut g, mut h] = self.state;
        for (word, round) in words.iter().zip(ROUNDS) {
            let large = e.rotate_right(6) ^ e.rotate_right(11) ^ e.rotate_right(25);
            let choice = (e & f) ^ (!e & g);
            let first = h.wrapping_add(large).wrapping_add(choice).wrapping_add(round).wrapping_add(*word);
            let small = a.rotate_right(2) ^ a.rotate_right(13) ^ a.rotate_right(22);
            let second = small.wrapping_add((a & b) ^ (a & c) ^ (b & c));
            (h, g, f, e, d, c, b, a) = (g, f, e, d.wrapping_add(first), c, b, a, first.wrapping_add(second));
        }
        for (sum, word) in self.state.iter_mut().zip([a, b, c, d, e, f, g, h]) {
            *sum = sum.wrapping_add(word);
        }
    }
}

/// A key, hashed into the two halves of HMAC, so that it is not hashed again for every datagram.
#[derive(Clone)]
pub struct Key {
    inner: Sha256,
    outer: Sha256,
}

impl Key {
    /// The key with these bytes.
    #[must_use]
    pub fn new(key: &[u8]) -> Key {
        let mut block = [0; BLOCK];
        if key.len() > BLOCK {
            let mut hash = Sha256::new();
            hash.update(key);
            block[..32].copy_from_slice(&hash.finish());
        } else {
            block[..key.len()].copy_from_slice(key);
        }
        let (mut inner, mut outer) = (Sha256::new(), Sha256::new());
        inner.update(&block.map(|byte| byte ^ 0x36));
        outer.update(&block.map(|byte| byte ^ 0x5c));
        Key { inner, outer }
    }

    /// HMAC-SHA256 of `first` followed by `rest`.
    #[must_use]
    pub fn digest(&self, first: &[u8], rest: &[u8]) -> [u8; 32] {
        let (mut inner, mut outer) = (self.inner.clone(), self.outer.clone());
        inner.update(first);
        inner.update(rest);
        outer.update(&inner.finish());
        outer.finish()
    }
}

/// Bytes of the tag of a datagram: the first half of a digest.
pub(crate) const TAG: usize = 16;

/// Key of a session, with its nonce: 0 before the answer to HELLO.
#[derive(Clone)]
pub struct Seal {
    /// The key.
    pub key: Key,
    /// The nonce.
    pub nonce: u64,
}

impl Seal {
    pub(crate) fn tag(&self, nonce: u64, begin: &[u8]) -> [u8; TAG] {
        let digest = self.key.digest(&nonce.to_le_bytes(), begin);
        core::array::from_fn(|place| digest[place])
    }

    /// Whether a tag is right; the time that it takes does not depend on where it is wrong.
    pub(crate) fn is_tag(&self, nonce: u64, begin: &[u8], tag: &[u8]) -> bool {
        let right = self.tag(nonce, begin);
        tag.len() == TAG && tag.iter().zip(right).fold(0, |wrong, (a, b)| wrong | a ^ b) == 0
    }
}

#[cfg(test)]
mod tests {
    use super::Key;

    fn hex(bytes: &[u8; 32]) -> [u8; 64] {
        let digit = |value: u8| b"0123456789abcdef"[usize::from(value)];
        core::array::from_fn(|place| digit(if place % 2 == 0 { bytes[place / 2] >> 4 } else { bytes[place / 2] & 15 }))
    }

    // RFC 4231, test cases 1, 2 and 6.
    #[test]
    fn published_tags() {
        let cases: [(&[u8], &[u8], &[u8; 64]); 3] = [
            (&[0x0b; 20], b"Hi There", b"b0344c61d8db38535ca8afceaf0bf12b881dc200c9833da726e9376c2e32cff7"),
            (
                b"Jefe",
                b"what do ya want for nothing?",
                b"5bdcc146bf60754e6a042426089575c75a003f089d2739839dec58b964ec3843",
            ),
            (
                &[0xaa; 131],
                b"Test Using Larger Than Block-Size Key - Hash Key First",
                b"60e431591ee0b67f0d8a26aacbf5b77f8e0bc6213728c5140546040f0ee37f54",
            ),
        ];
        for (key, data, tag) in cases {
            for split in [0, 3, data.len()] {
                assert_eq!(&hex(&Key::new(key).digest(&data[..split], &data[split..])), tag);
            }
        }
    }
}
