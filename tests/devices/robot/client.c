/* A client of the robot, written from docs/reference/robot-protocol.md and its header alone:
 *
 *     client PORT [KEY]
 *
 * takes control with limits of its own, enables, inserts 2 mm, shows that 9 mm is refused, says goodbye, and prints
 * the results of its commands and the last depth. KEY is the shared key as text. */
#define _POSIX_C_SOURCE 200809L
#include <arpa/inet.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "needleplan_robot.h"

/* SHA-256 (FIPS 180-4) of at most 400 bytes, and HMAC (RFC 2104) with a key of at most 64 bytes. */
static uint32_t turned(uint32_t x, int n) { return x >> n | x << (32 - n); }

static void sha256(const uint8_t *data, size_t length, uint8_t out[32]) {
    uint32_t k[64], h[8];
    uint8_t block[512] = {0};
    size_t blocks = (length + 9 + 63) / 64;
    int count = 0;
    for (uint32_t n = 2; count < 64; ++n) { /* roots of the primes, by whole numbers: floor(2^32 frac(root)) */
        int prime = 1;
        for (uint32_t d = 2; d * d <= n; ++d)
            prime &= n % d != 0;
        if (!prime)
            continue;
        uint64_t low = 0, high = (uint64_t)8 << 32;
        while (high - low > 1) { /* cube root of n, times 2^32 */
            uint64_t middle = (low + high) / 2;
            unsigned __int128 square = (unsigned __int128)middle * middle >> 32;
            if ((square * middle >> 32) < ((unsigned __int128)n << 32))
                low = middle;
            else
                high = middle;
        }
        uint64_t cube = low - 4; /* `square` was rounded down */
        while ((unsigned __int128)(cube + 1) * (cube + 1) < ((unsigned __int128)n << 96) / (cube + 1))
            ++cube;
        k[count] = (uint32_t)cube;
        if (count < 8) { /* square root of n, times 2^32 */
            uint64_t root = 0;
            for (uint64_t bit = (uint64_t)1 << 36; bit; bit >>= 1)
                if ((unsigned __int128)(root | bit) * (root | bit) <= (unsigned __int128)n << 64)
                    root |= bit;
            h[count] = (uint32_t)root;
        }
        ++count;
    }
    memcpy(block, data, length);
    block[length] = 0x80;
    for (int byte = 0; byte < 8; ++byte)
        block[64 * blocks - 1 - byte] = (uint8_t)((uint64_t)length * 8 >> 8 * byte);
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

static void hmac(const char *key, const uint8_t *data, size_t length, uint8_t out[32]) {
    uint8_t inner[400] = {0}, outer[96] = {0};
    memcpy(inner, key, strlen(key));
    memcpy(outer, key, strlen(key));
    for (int i = 0; i < 64; ++i) {
        inner[i] ^= 0x36;
        outer[i] ^= 0x5C;
    }
    memcpy(inner + 64, data, length);
    sha256(inner, 64 + length, outer + 64);
    sha256(outer, 96, out);
}

static int link_;
static const char *key;
static uint32_t session = 77, sequence, number;
static uint64_t nonce, robot_ns, heard_ns;
static npl_status status;

static uint64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

static void transmit(void *message, size_t size) {
    uint8_t out[NPL_MOST], tag[32], data[8 + NPL_MOST];
    npl_head *head = message;
    head->session = session;
    head->sequence = ++sequence;
    head->sent_ns = now_ns();
    if (key) {
        head->size = (uint16_t)(size + NPL_TAG);
        memcpy(data, &nonce, 8);
        memcpy(data + 8, message, size - 4);
        hmac(key, data, 8 + size - 4, tag);
        size = npl_seal_tagged(message, size, tag, out);
    } else {
        npl_seal(message, size);
        memcpy(out, message, size);
    }
    if (send(link_, out, size, 0) < 0)
        perror("send");
}

/* Receive for 5 ms, however many statuses come. Return the result of the answer to command `about`, or -1. */
static int receive(uint32_t about) {
    struct pollfd ready = {link_, POLLIN, 0};
    const uint64_t end_ns = now_ns() + 5000000u;
    for (uint64_t now = now_ns(); now < end_ns; now = now_ns()) {
        if (poll(&ready, 1, (int)((end_ns - now) / 1000000u) + 1) <= 0)
            break;
        uint8_t data[256];
        ssize_t length = recv(link_, data, sizeof data, 0);
        size_t extra = key ? NPL_TAG : 0;
        if (length < (ssize_t)sizeof(npl_head))
            continue;
        uint8_t kind = data[5];
        npl_answer answer;
        if (kind == NPL_STATUS && npl_check(data, (size_t)length, kind, sizeof status + extra) == 0)
            memcpy(&status, data, sizeof status);
        else if (kind != NPL_ANSWER || npl_check(data, (size_t)length, kind, sizeof answer + extra) != 0)
            continue;
        robot_ns = ((npl_head *)(void *)data)->sent_ns;
        heard_ns = now_ns();
        if (kind == NPL_ANSWER) {
            memcpy(&answer, data, sizeof answer);
            if (answer.head.number == about) {
                if (answer.asked == NPL_HELLO)
                    nonce = answer.nonce;
                return answer.result;
            }
        }
    }
    return -1;
}

static int order(const char *name, uint8_t kind, double target, double speed) {
    int result = -1, attempt = 0;
    ++number;
    for (; attempt < 2000 && result < 0; ++attempt) {
        if (kind == NPL_HELLO) {
            npl_hello hello = {0};
            npl_begin(&hello.head, kind, sizeof hello);
            hello.head.number = number;
            hello.most_mm = 5;
            hello.speed_mm_s = 8;
            hello.silence_us = 5000000;
            transmit(&hello, sizeof hello);
        } else {
            npl_command command = {0};
            npl_begin(&command.head, kind, sizeof command);
            command.head.number = number;
            command.deadline_ns = robot_ns + (now_ns() - heard_ns) + 5000000000u;
            command.target = target;
            command.speed = speed;
            command.silence_us = 5000000;
            transmit(&command, sizeof command);
        }
        result = receive(number);
    }
    printf("%s %d\n", name, result);
    if (kind == NPL_GOODBYE)
        fprintf(stderr, "%d\n", attempt);
    return result;
}

int main(int count, char **words) {
    struct sockaddr_in robot = {0};
    if (count < 2)
        return 2;
    key = count > 2 ? words[2] : NULL;
    robot.sin_family = AF_INET;
    robot.sin_port = htons((uint16_t)atoi(words[1]));
    robot.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    link_ = socket(AF_INET, SOCK_DGRAM, 0);
    if (connect(link_, (struct sockaddr *)&robot, sizeof robot) != 0)
        return 2;
    order("hello", NPL_HELLO, 0, 0);
    order("reset", NPL_RESET, 0, 0);
    order("enable", NPL_ENABLE, 0, 0);
    order("insert 9 mm", NPL_INSERT, 9, 5);
    int accepted = order("insert 2 mm", NPL_INSERT, 2, 5) == 0;
    for (int turn = 0; accepted && turn < 2000 && ((status.flags & NPL_MOVING) || status.depth_mm < 1.99); ++turn) {
        npl_command alive = {0};
        npl_begin(&alive.head, NPL_ALIVE, sizeof alive);
        alive.deadline_ns = robot_ns + (now_ns() - heard_ns) + 5000000000u;
        alive.silence_us = 5000000;
        transmit(&alive, sizeof alive);
        receive(0);
    }
    printf("depth %.2f faults %u\n", status.depth_mm, status.faults);
    order("goodbye", NPL_GOODBYE, 0, 0);
    close(link_);
    return 0;
}
