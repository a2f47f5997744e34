/* The needleplan robot protocol, version 3: all bytes, codes and units. robot-protocol.md has the rules.
 *
 * Everything is little-endian, doubles are those of IEEE 754, and no structure has padding. On a machine with the same
 * order of bytes, copy the structures to and from datagrams as they are. A number before a field is its offset in
 * bytes. A command:
 *
 *     npl_command stop = {0};
 *     npl_begin(&stop.head, NPL_STOP, sizeof stop);
 *     stop.head.session = session; stop.head.sequence = ++sequence; stop.head.number = ++number;
 *     npl_seal(&stop, sizeof stop);
 *     sendto(socket, &stop, sizeof stop, 0, ...);
 */
#ifndef NEEDLEPLAN_ROBOT_H
#define NEEDLEPLAN_ROBOT_H

#include <float.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum {
    NPL_VERSION = 3,
    NPL_OLDEST_VERSION = 2, /* a capture side also obeys it: HELLO of version 2 begins a session of version 2 */
    NPL_PORT = 5005,
    NPL_TAG = 16,        /* bytes of a tag */
    NPL_MOST = 112,      /* bytes of the largest datagram */
    NPL_FRAME = 117      /* bytes of the largest frame of a serial line */
};

/* Kinds of datagrams; those of the capture side have the highest bit. */
enum {
    NPL_HELLO = 0x01,    /* requests control */
    NPL_ENABLE = 0x02,   /* permits motion */
    NPL_INSERT = 0x03,   /* moves to a depth: target in mm, speed in mm/s */
    NPL_ROTATE = 0x04,   /* rotates to a roll: target in rad, speed in rad/s */
    NPL_STOP = 0x05,     /* stops both axes; with session 0 anyone may send it, and gets statuses for 0.5 s */
    NPL_ALIVE = 0x06,    /* heartbeat, has no answer */
    NPL_RESET = 0x07,    /* changes from FAULT to DISABLED */
    NPL_GOODBYE = 0x08,  /* stops, disables, releases control */
    NPL_HOME = 0x09,     /* a person has found the zero; with NPL_UNHOME, since version 3 */
    NPL_UNHOME = 0x0A,   /* the zero is lost; needs no deadline */
    NPL_STATUS = 0x80,
    NPL_ANSWER = 0x81,
    NPL_COMPACT = 0x82   /* status with floats, on a serial line */
};

enum {
    NPL_RESULT_ACCEPTED = 0,
    NPL_RESULT_BUSY = 1,             /* another controller has the robot */
    NPL_RESULT_OLD_SESSION = 2,      /* ended, or never begun */
    NPL_RESULT_WRONG_VERSION = 3,
    NPL_RESULT_LATE = 4,             /* after its deadline, or without one */
    NPL_RESULT_SUPERSEDED = 5,       /* a command with a higher number arrived before */
    NPL_RESULT_NOT_ENABLED = 6,
    NPL_RESULT_OUT_OF_RANGE = 7,     /* not finite, not positive, or beyond the drive */
    NPL_RESULT_IN_FAULT = 8,
    NPL_RESULT_DEPTH_BEYOND = 9,     /* from here to 12: beyond a limit of the session */
    NPL_RESULT_SPEED_BEYOND = 10,
    NPL_RESULT_ROLL_BEYOND = 11,
    NPL_RESULT_ROTATION_BEYOND = 12, /* rotation speed */
    NPL_RESULT_DEADLINE_BEYOND = 13, /* too far in the future */
    NPL_RESULT_NOT_AUTHENTIC = 14    /* the robot has another key */
};

enum {
    NPL_STATE_DISABLED = 0,
    NPL_STATE_ENABLED = 1,
    NPL_STATE_FAULT = 3
};

/* Bits of npl_status.flags; in version 2 only the first. */
enum {
    NPL_MOVING = 0x01,   /* an axis has not completed its motion */
    NPL_HOMED = 0x02,    /* the zero is known */
    NPL_STANDING = 0x04  /* the measured positions of both axes have stood for 50 ms, within 0.01 mm and 0.002 rad */
};

/* Bits of npl_status.faults. */
enum {
    NPL_FAULT_WATCHDOG = 0x01,     /* nothing was received from the controller while the robot moved */
    NPL_FAULT_ESTOP = 0x02,        /* the emergency stop was pressed */
    NPL_FAULT_DRIVE = 0x04,        /* a drive reports a fault */
    NPL_FAULT_FOLLOWING = 0x08,    /* an axis does not follow */
    NPL_FAULT_LIMIT = 0x10,        /* a limit switch was reached */
    NPL_FAULT_ENCODER = 0x20,      /* an encoder has jumped or counts in the wrong direction */
    NPL_FAULT_NO_MOTION = 0x40,    /* an axis does not move */
    NPL_FAULT_FOREIGN_STOP = 0x80, /* another sender ordered a stop */
    NPL_FAULT_BEYOND = 0x100       /* the measured depth or roll is beyond the limits of the session */
};

/* The first 40 bytes of every datagram. The first six bytes and the checksum are the same in every version. */
typedef struct {
    uint8_t magic[4];     /*  0 "NPLR" */
    uint8_t version;      /*  4 3; in a session of version 2: 2 */
    uint8_t kind;         /*  5 */
    uint16_t size;        /*  6 of the whole datagram */
    uint32_t session;     /*  8 drawn at random by the control side, not 0; an answer has that of its command */
    uint32_t sequence;    /* 12 control side: counts datagrams; capture side: counts statuses, and separately answers */
    uint64_t sent_ns;     /* 16 time of sending on the monotonic clock of the sender */
    uint64_t echo_ns;     /* 24 sent_ns of the last datagram from the other side; 0: none */
    uint32_t held_us;     /* 32 time since that datagram was received */
    uint32_t number;      /* 36 command: from 1, the same when it is repeated; 0 for ALIVE. Answer: that of its command.
                                Status: that of the last accepted command */
} npl_head;

/* HELLO, 96 bytes: the limits of the session. 0 selects the limit of the robot; least_mm and most_mm are both 0 or
 * neither. */
typedef struct {
    npl_head head;
    double least_mm;       /* 40 smallest depth of INSERT */
    double most_mm;        /* 48 largest depth of INSERT */
    double speed_mm_s;     /* 56 largest speed of INSERT */
    double roll_rad;       /* 64 largest roll of ROTATE to either side */
    double rotation_rad_s; /* 72 largest speed of ROTATE */
    uint32_t silence_us;   /* 80 as in a command */
    uint32_t valid_us;     /* 84 longest time from now to the deadline of a motion */
    uint32_t unused;       /* 88 0 */
    uint32_t crc;          /* 92 */
} npl_hello;

/* Every other command, 72 bytes. */
typedef struct {
    npl_head head;
    uint64_t deadline_ns; /* 40 latest time of execution on the clock of the robot; STOP and GOODBYE need none */
    double target;        /* 48 mm (INSERT), rad (ROTATE) */
    double speed;         /* 56 mm/s, rad/s; positive */
    uint32_t silence_us;  /* 64 time without a valid datagram after which the robot stops; 0: the value of the robot */
    uint32_t crc;         /* 68 */
} npl_command;

/* Answer, 56 bytes. */
typedef struct {
    npl_head head;
    uint64_t nonce;       /* 40 of the session, in the answer to HELLO; else 0 */
    uint8_t asked;        /* 48 kind of the command */
    uint8_t state;        /* 49 */
    uint16_t result;      /* 50 */
    uint32_t crc;         /* 52 */
} npl_answer;

/* Status, 88 bytes, 1000 times per second. */
typedef struct {
    npl_head head;
    double depth_mm;       /* 40 encoder, positive into the tissue */
    double velocity_mm_s;  /* 48 */
    double roll_rad;       /* 56 */
    double velocity_rad_s; /* 64 */
    uint32_t faults;       /* 72 bits */
    uint8_t state;         /* 76 */
    uint8_t flags;         /* 77 bits */
    uint16_t overruns;     /* 78 number of late ticks of the servo, at most 65535 */
    uint32_t missed;       /* 80 number of missing datagrams of the control side in this session */
    uint32_t crc;          /* 84 */
} npl_status;

/* Status of a serial line, 72 bytes, 200 to 400 times per second: that above, with floats of 4 bytes. */
typedef struct {
    npl_head head;
    float depth_mm;        /* 40 */
    float velocity_mm_s;   /* 44 */
    float roll_rad;        /* 48 */
    float velocity_rad_s;  /* 52 */
    uint32_t faults;       /* 56 */
    uint8_t state;         /* 60 */
    uint8_t flags;         /* 61 */
    uint16_t overruns;     /* 62 */
    uint32_t missed;       /* 64 */
    uint32_t crc;          /* 68 */
} npl_compact;

/* CRC-32 as zlib and Ethernet have it; bit by bit, because 88 bytes need no table. */
static inline uint32_t npl_crc(const void *data, size_t length) {
    const uint8_t *byte = (const uint8_t *)data;
    uint32_t crc = 0xFFFFFFFFu;
    while (length--) {
        crc ^= *byte++;
        for (int bit = 0; bit < 8; ++bit)
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

static inline void npl_begin(npl_head *head, uint8_t kind, size_t size) {
    memcpy(head->magic, "NPLR", 4);
    head->version = NPL_VERSION;
    head->kind = kind;
    head->size = (uint16_t)size;
}

/* Write the checksum, which is the last field of each structure. */
static inline void npl_seal(void *message, size_t size) {
    uint32_t crc = npl_crc(message, size - 4);
    memcpy((uint8_t *)message + size - 4, &crc, 4);
}

/* Write into `out` (NPL_MOST bytes) the datagram of `size` bytes with a tag before its checksum, and return its size.
 *
 * The tag is the first half of HMAC-SHA256(key, nonce as 8 bytes little-endian, then the bytes before the tag). Compute
 * it with the cryptographic library of the platform over `message` without its last 4 bytes, after `head.size` has been
 * increased by NPL_TAG. HELLO and its answer have the nonce 0, all others the nonce of the answer to HELLO. */
static inline size_t npl_seal_tagged(const void *message, size_t size, const uint8_t tag[NPL_TAG], uint8_t *out) {
    uint16_t tagged = (uint16_t)(size + NPL_TAG);
    memcpy(out, message, size - 4);
    memcpy(out + offsetof(npl_head, size), &tagged, sizeof tagged);
    memcpy(out + size - 4, tag, NPL_TAG);
    npl_seal(out, tagged);
    return tagged;
}

/* Range of one axis in a session, for the capture side; `allowed` is the allowed distance beyond the range. */
typedef struct {
    double least;
    double most;
    double allowed;
} npl_range;

/* Begin a range: after HELLO with the limits of the session, and after RESET. The axis may be beyond the range now. */
static inline void npl_range_begin(npl_range *range, double least, double most) {
    range->least = least;
    range->most = most;
    range->allowed = DBL_MAX;
}

/* Return 1 if the measured position is no number, or is farther beyond the range than the smallest distance since
 * npl_range_begin plus the tolerance: then stop both axes with NPL_FAULT_BEYOND. Call it in every servo tick, whatever
 * was commanded. */
static inline int npl_range_beyond(npl_range *range, double measured, double tolerance) {
    double below = range->least - measured, above = measured - range->most;
    double distance = below > above ? below : above;
    int beyond;
    if (measured - measured != 0)
        return 1;
    if (distance < 0)
        distance = 0;
    beyond = distance > range->allowed + tolerance;
    if (distance < range->allowed)
        range->allowed = distance;
    return beyond;
}

/* Return 0 where a datagram is a sound one of a kind and its size; else what is wrong: 1 not of this protocol, or
 * damaged; 2 neither this version nor the oldest supported one; 3 another kind or size. */
static inline int npl_check(const void *datagram, size_t length, uint8_t kind, size_t size) {
    npl_head head;
    uint32_t crc;
    if (length < 10 || memcmp(datagram, "NPLR", 4) != 0)
        return 1;
    memcpy(&crc, (const uint8_t *)datagram + length - 4, 4);
    if (crc != npl_crc(datagram, length - 4))
        return 1;
    if (((const uint8_t *)datagram)[4] != NPL_VERSION && ((const uint8_t *)datagram)[4] != NPL_OLDEST_VERSION)
        return 2;
    if (length != size || length < sizeof head)
        return 3;
    memcpy(&head, datagram, sizeof head);
    return head.kind == kind && head.size == size ? 0 : 3;
}

/* Return the double in 8 bytes of a datagram as a float, for a compiler whose double has 4 bytes (there, address the
 * fields by their offsets). It is rounded toward 0; too large a number is infinite, one below 1.2e-38 is 0. */
static inline float npl_single(const void *field) {
    uint64_t bits;
    uint32_t single;
    int32_t exponent;
    float value;
    memcpy(&bits, field, 8);
    exponent = (int32_t)(bits >> 52 & 0x7FF);
    single = (uint32_t)(bits >> 32) & 0x80000000u;
    if (exponent == 0x7FF)
        single |= 0x7F800000u | (bits << 12 ? 0x400000u : 0);
    else if (exponent > 1023 + 127)
        single |= 0x7F800000u;
    else if (exponent > 1023 - 127)
        single |= (uint32_t)(exponent - 1023 + 127) << 23 | ((uint32_t)(bits >> 29) & 0x7FFFFFu);
    memcpy(&value, &single, 4);
    return value;
}

/* A serial line carries frames: sender and its complement, then the datagram, stuffed by COBS, between two bytes 0.
 * `sender` is any number; an answer or status carries that of whom it is for. Write a frame into `out` (NPL_FRAME bytes)
 * and return its size. */
static inline size_t npl_frame(uint8_t sender, const void *datagram, size_t length, uint8_t *out) {
    size_t code = 1, size = 2, at;
    out[0] = 0;
    for (at = 0; at < length + 2; ++at) {
        uint8_t byte = at == 0 ? sender : at == 1 ? (uint8_t)~sender : ((const uint8_t *)datagram)[at - 2];
        if (byte) {
            out[size++] = byte;
        } else {
            out[code] = (uint8_t)(size - code);
            code = size++;
        }
    }
    out[code] = (uint8_t)(size - code);
    out[size++] = 0;
    return size;
}

/* Bytes of a line since the last byte 0; begin with {0}. */
typedef struct {
    uint8_t bytes[NPL_FRAME];
    size_t size;
} npl_unframer;

/* Take the next byte of a line. If it ends a frame, return the size of its datagram, which then begins at bytes + 2,
 * behind its sender; else 0. Check the datagram by npl_check. */
static inline size_t npl_unframe(npl_unframer *line, uint8_t byte) {
    size_t size = line->size, read = 0, written = 0;
    if (byte) {
        if (size < NPL_FRAME)
            line->bytes[line->size++] = byte;
        return 0;
    }
    line->size = 0;
    while (read < size) {
        size_t end = read + line->bytes[read];
        if (end > size || size == NPL_FRAME)
            return 0;
        if (read)
            line->bytes[written++] = 0;
        while (++read < end)
            line->bytes[written++] = line->bytes[read];
    }
    return written > 2 && (line->bytes[0] ^ line->bytes[1]) == 0xFF ? written - 2 : 0;
}

#endif
