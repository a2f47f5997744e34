/* The tag of a datagram of the robot protocol: the first half of an HMAC-SHA256 (FIPS 180-4, RFC 2104), in C99 without
 * allocation. Replace it by the cryptographic library of your platform if it has one. */
#ifndef ROBOT_TAG_H
#define ROBOT_TAG_H

#include <stdint.h>
#include <string.h>

#include "needleplan_robot.h"

static uint32_t turned(uint32_t x, int n) { return x >> n | x << (32 - n); }

/* SHA-256 of at most 400 bytes. */
static void sha256(const uint8_t *data, size_t length, uint8_t out[32]) {
    static const uint32_t k[64] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2,
    };
    uint32_t h[8] = {
    0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19,
    };
    uint8_t block[512] = {0};
    size_t blocks = (length + 9 + 63) / 64;
    memcpy(block, data, length);
    block[length] = 0x80;
    for (int byte = 0; byte < 8; ++byte)
        block[64 * blocks - 1 - (size_t)byte] = (uint8_t)((uint64_t)length * 8 >> 8 * byte);
    for (size_t at = 0; at < blocks; ++at) {
        uint32_t w[64], v[8];
        for (int i = 0; i < 16; ++i)
            w[i] = (uint32_t)block[64 * at + 4 * i] << 24 | (uint32_t)block[64 * at + 4 * i + 1] << 16 |
                   (uint32_t)block[64 * at + 4 * i + 2] << 8 | block[64 * at + 4 * i + 3];
        for (int i = 16; i < 64; ++i)
            w[i] = w[i - 16] + w[i - 7] + (turned(w[i - 15], 7) ^ turned(w[i - 15], 18) ^ w[i - 15] >> 3) +
                   (turned(w[i - 2], 17) ^ turned(w[i - 2], 19) ^ w[i - 2] >> 10);
        memcpy(v, h, sizeof v);
        for (int i = 0; i < 64; ++i) {
            uint32_t one = v[7] + (turned(v[4], 6) ^ turned(v[4], 11) ^ turned(v[4], 25)) +
                           ((v[4] & v[5]) ^ (~v[4] & v[6])) + k[i] + w[i];
            uint32_t two = (turned(v[0], 2) ^ turned(v[0], 13) ^ turned(v[0], 22)) +
                           ((v[0] & v[1]) ^ (v[0] & v[2]) ^ (v[1] & v[2]));
            memmove(v + 1, v, 7 * sizeof *v);
            v[4] += one;
            v[0] = one + two;
        }
        for (int i = 0; i < 8; ++i)
            h[i] += v[i];
    }
    for (int i = 0; i < 32; ++i)
        out[i] = (uint8_t)(h[i / 4] >> (24 - 8 * (i % 4)));
}

/* Write the tag of a message: the bytes of a datagram before its tag, of at most 300 bytes; the key has at most 64. */
static void npl_tag(const char *key, uint64_t nonce, const void *message, size_t length, uint8_t tag[NPL_TAG]) {
    uint8_t inner[400] = {0}, outer[96] = {0}, digest[32];
    memcpy(inner, key, strlen(key));
    memcpy(outer, key, strlen(key));
    for (int i = 0; i < 64; ++i) {
        inner[i] ^= 0x36;
        outer[i] ^= 0x5C;
    }
    memcpy(inner + 64, &nonce, 8);
    memcpy(inner + 72, message, length);
    sha256(inner, 72 + length, outer + 64);
    sha256(outer, 96, digest);
    memcpy(tag, digest, NPL_TAG);
}

#endif
