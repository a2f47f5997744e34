/* A needle robot with two simulated axes that speaks the needleplan robot protocol, for POSIX.
 *
 *     cc -std=c99 -Wall -Wextra -Werror -O2 -I../../docs/reference robot.c -o robot -lm && ./robot 5105 [KEY]
 *
 * serves at UDP port 5105; `./robot /dev/ttyS1 [KEY]` at a serial line, with compact statuses. Replace `axis_tick`,
 * `axis_stop` and the sleep of `main` by your drives and your timer of 1 kHz. All else is the capture side of the protocol,
 * by its rules; KEY is a shared key of 16 to 64 characters. No memory is allocated.
 */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdio.h>
#include <time.h>

#include "link.h"
#include "needleplan_robot.h"
#include "tag.h"

#define MS 1000000ull
#define ENDED 64
#define LINE_NS 2500000ull /* time between two statuses on a line, for all recipients together */

/* Times, which tests on a busy machine make longer. */
#ifndef LONGEST_US
#define LONGEST_US 340000u    /* longest watchdog time of a session */
#define VALID_US 1500000u     /* longest time to the deadline of a motion */
#define RELEASE_MS 5000u      /* silence at rest after which a session ends */
#endif

enum { DEPTH, ROLL, AXES };

typedef struct {
    double position, speed, target; /* mm or rad; the speed is 0 at rest */
    double stood, silent;           /* position where the axis was last seen standing, and where the silence began */
    npl_range range;
} axis_t;

typedef struct {
    peer_t peer;
    uint64_t until_ns, due_ns, echo_ns;
    uint32_t sequence, number;
    uint8_t version;
} stopper_t;

/* Limits of this robot: no session has wider ones. */
static const double MOST[AXES] = {150.0, 200.0}, FASTEST[AXES] = {20.0, 15.0}, TOLERANCE[AXES] = {0.5, 0.2};
static const double LEAST_MM = -20.0;
static const double STILL[AXES] = {0.01, 0.002}, LEFT[AXES] = {0.1, 0.02}; /* motion after a stop, and in silence */
static const uint32_t SHORTEST_US = 5000;

static axis_t axis[AXES];
static npl_hello limits;              /* of the session */
static peer_t controller;
static stopper_t stopper;             /* the last sender of a STOP without a session */
static uint32_t session, sequence_in, number_in, accepted, statuses, answers, silence_us, missed, faults;
static uint32_t ended[ENDED], ended_count;
static uint64_t heard_ns, echo_ns, echo_in_ns, nonce, moved_ns, line_due_ns;
static uint8_t state = NPL_STATE_DISABLED, homed = 1;
static int is_stopped;                /* a stop was ordered, and no motion since */
static npl_answer last;               /* the answer to number_in */
static const char *key;

static uint64_t now_ns(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (uint64_t)time.tv_sec * 1000000000ull + (uint64_t)time.tv_nsec;
}

/* The drives: these two functions are yours. */
static void axis_stop(axis_t *own) { own->speed = 0; }

static void axis_tick(axis_t *own, double seconds) {
    double left = own->target - own->position, most = fabs(own->speed) * seconds;
    own->position += fabs(left) <= most ? left : copysign(most, left);
    if (own->position == own->target)
        own->speed = 0;
}

static int is_moving(void) { return axis[DEPTH].speed != 0 || axis[ROLL].speed != 0; }

static void stop(uint32_t fault) {
    for (int which = 0; which < AXES; ++which)
        axis_stop(&axis[which]);
    is_stopped = 1;
    if (fault) {
        faults |= fault;
        state = NPL_STATE_FAULT;
    }
}

static void begin_ranges(void) {
    npl_range_begin(&axis[DEPTH].range, session ? limits.least_mm : LEAST_MM, session ? limits.most_mm : MOST[DEPTH]);
    npl_range_begin(&axis[ROLL].range, session ? -limits.roll_rad : -MOST[ROLL], session ? limits.roll_rad : MOST[ROLL]);
}

static void end_session(void) {
    ended[ended_count++ % ENDED] = session;
    session = 0;
    stop(0);
    if (state == NPL_STATE_ENABLED)
        state = NPL_STATE_DISABLED;
    begin_ranges();
}

static npl_answer answer_to(const npl_head *head, uint64_t now, uint16_t result) {
    npl_answer answer = {0};
    npl_begin(&answer.head, NPL_ANSWER, sizeof answer);
    answer.head.version = head->version;
    answer.head.session = head->session;
    answer.head.sequence = ++answers;
    answer.head.sent_ns = now;
    answer.head.echo_ns = head->sent_ns;
    answer.head.number = head->number;
    answer.nonce = head->kind == NPL_HELLO && session && head->session == session ? nonce : 0;
    answer.asked = head->kind;
    answer.state = state;
    answer.result = result;
    npl_seal(&answer, sizeof answer);
    return answer;
}

/* Send a sealed message; with a key, also its tag. Only what belongs to the session has the nonce of the session. */
static void send_to(peer_t to, const void *message, size_t size) {
    uint8_t out[NPL_MOST], tag[NPL_TAG];
    memcpy(out, message, size);
    if (key) {
        const npl_head *head = (const npl_head *)(const void *)out;
        int greets = head->kind == NPL_ANSWER && out[offsetof(npl_answer, asked)] == NPL_HELLO;
        uint16_t tagged = (uint16_t)(size + NPL_TAG);
        memcpy(out + offsetof(npl_head, size), &tagged, sizeof tagged);
        npl_tag(key, session && head->session == session && !greets ? nonce : 0, out, size - 4, tag);
        memcpy(out + size - 4, tag, NPL_TAG);
        npl_seal(out, size = tagged);
    }
    link_send(to, out, size);
}

/* Return whether the tag of a datagram is right: that of its session, for HELLO that of the nonce 0. */
static int is_authentic(const uint8_t *datagram, size_t size, uint8_t kind) {
    uint8_t tag[NPL_TAG];
    if (size != (kind == NPL_HELLO ? sizeof(npl_hello) : sizeof(npl_command)) + NPL_TAG)
        return 0;
    npl_tag(key, kind == NPL_HELLO || !session ? 0 : nonce, datagram, size - NPL_TAG - 4, tag);
    return memcmp(tag, datagram + size - NPL_TAG - 4, NPL_TAG) == 0;
}

static void send_status(peer_t to, npl_head head, uint8_t version, uint64_t now) {
    npl_status status = {0};
    int standing = now - moved_ns > 50 * MS;
    npl_begin(&head, NPL_STATUS, sizeof status);
    head.version = version;
    head.sent_ns = now;
    status.head = head;
    status.depth_mm = axis[DEPTH].position;
    status.velocity_mm_s = copysign(axis[DEPTH].speed, axis[DEPTH].target - axis[DEPTH].position);
    status.roll_rad = axis[ROLL].position;
    status.velocity_rad_s = copysign(axis[ROLL].speed, axis[ROLL].target - axis[ROLL].position);
    status.faults = faults;
    status.state = state;
    status.flags = (uint8_t)((is_moving() ? NPL_MOVING : 0) | (homed ? NPL_HOMED : 0) | (standing ? NPL_STANDING : 0));
    if (version == NPL_OLDEST_VERSION)
        status.flags &= NPL_MOVING;
    status.missed = missed;
    if (link_is_line) {
        npl_compact compact = {status.head, (float)status.depth_mm, (float)status.velocity_mm_s, (float)status.roll_rad,
                               (float)status.velocity_rad_s, faults, state, status.flags, 0, missed, 0};
        compact.head.kind = NPL_COMPACT;
        compact.head.size = sizeof compact;
        npl_seal(&compact, sizeof compact);
        send_to(to, &compact, sizeof compact);
        return;
    }
    npl_seal(&status, sizeof status);
    send_to(to, &status, sizeof status);
}

/* A limit of the session: what is asked, or the limit of the robot for 0. Negative if it is wider. */
static double limit(double asked, double own) { return asked == 0 ? own : asked > 0 && asked <= own ? asked : -1; }

static uint16_t hello(npl_hello asked, peer_t from) {
    if (session)
        return asked.head.session == session && is_same(from, controller) ? NPL_RESULT_ACCEPTED : NPL_RESULT_BUSY;
    if (asked.head.session == 0)
        return NPL_RESULT_OLD_SESSION;
    for (int at = 0; at < ENDED; ++at)
        if (asked.head.session == ended[at])
            return NPL_RESULT_OLD_SESSION;
    if (asked.least_mm == 0 && asked.most_mm == 0)
        asked.least_mm = LEAST_MM, asked.most_mm = MOST[DEPTH];
    if (!isfinite(asked.least_mm + asked.most_mm + asked.speed_mm_s + asked.roll_rad + asked.rotation_rad_s))
        return NPL_RESULT_OUT_OF_RANGE;
    if (!(asked.least_mm >= LEAST_MM && asked.most_mm <= MOST[DEPTH] && asked.least_mm < asked.most_mm))
        return NPL_RESULT_DEPTH_BEYOND;
    if (!((asked.speed_mm_s = limit(asked.speed_mm_s, FASTEST[DEPTH])) > 0))
        return NPL_RESULT_SPEED_BEYOND;
    if (!((asked.roll_rad = limit(asked.roll_rad, MOST[ROLL])) > 0))
        return NPL_RESULT_ROLL_BEYOND;
    if (!((asked.rotation_rad_s = limit(asked.rotation_rad_s, FASTEST[ROLL])) > 0))
        return NPL_RESULT_ROTATION_BEYOND;
    asked.valid_us = asked.valid_us ? asked.valid_us : VALID_US;
    if (asked.valid_us > VALID_US)
        return NPL_RESULT_DEADLINE_BEYOND;
    limits = asked;
    session = asked.head.session;
    nonce = now_ns() ^ (uint64_t)session << 32;
    controller = from;
    number_in = accepted = asked.head.number;
    sequence_in = asked.head.sequence;
    statuses = missed = 0;
    silence_us = 30000;
    begin_ranges();
    return NPL_RESULT_ACCEPTED;
}

static uint16_t move(axis_t *own, const npl_command *command, double least, double most, double fastest, int which) {
    if (!isfinite(command->target) || !isfinite(command->speed) || command->speed <= 0)
        return NPL_RESULT_OUT_OF_RANGE;
    if (command->target < least || command->target > most)
        return which == DEPTH ? NPL_RESULT_DEPTH_BEYOND : NPL_RESULT_ROLL_BEYOND;
    if (command->speed > fastest)
        return which == DEPTH ? NPL_RESULT_SPEED_BEYOND : NPL_RESULT_ROTATION_BEYOND;
    own->target = command->target;
    own->speed = command->target == own->position ? 0 : command->speed;
    is_stopped = 0;
    return NPL_RESULT_ACCEPTED;
}

static uint16_t execute(const npl_command *command, uint64_t now) {
    uint8_t kind = command->head.kind;
    int motion = kind == NPL_INSERT || kind == NPL_ROTATE;
    if (kind == NPL_STOP || kind == NPL_GOODBYE) {
        stop(0);
        return NPL_RESULT_ACCEPTED;
    }
    if (kind == NPL_UNHOME) {
        homed = 0;
        return NPL_RESULT_ACCEPTED;
    }
    if (command->deadline_ns == 0 || now > command->deadline_ns)
        return NPL_RESULT_LATE;
    if (motion && command->deadline_ns - now > limits.valid_us * 1000ull)
        return NPL_RESULT_DEADLINE_BEYOND;
    if (kind == NPL_RESET) {
        stop(0);
        state = NPL_STATE_DISABLED;
        faults = 0;
        begin_ranges();
        return NPL_RESULT_ACCEPTED;
    }
    if (state == NPL_STATE_FAULT)
        return NPL_RESULT_IN_FAULT;
    if (kind == NPL_HOME)
        homed = 1;
    else if (kind == NPL_ENABLE)
        state = NPL_STATE_ENABLED;
    else if (state != NPL_STATE_ENABLED)
        return NPL_RESULT_NOT_ENABLED;
    else if (kind == NPL_INSERT)
        return move(&axis[DEPTH], command, limits.least_mm, limits.most_mm, limits.speed_mm_s, DEPTH);
    else
        return move(&axis[ROLL], command, -limits.roll_rad, limits.roll_rad, limits.rotation_rad_s, ROLL);
    return NPL_RESULT_ACCEPTED;
}

static void receive(const uint8_t *datagram, size_t size, peer_t from, uint64_t now) {
    npl_command command;
    npl_answer answer;
    uint8_t kind = size > 5 ? datagram[5] : 0;
    size_t usual = kind == NPL_HELLO ? sizeof(npl_hello) : sizeof command;
    int wrong = npl_check(datagram, size, kind, size == usual + NPL_TAG ? size : usual);
    if (kind & 0x80 || (wrong ? wrong != 2 : kind < NPL_HELLO || kind > NPL_UNHOME) || size < sizeof(npl_head))
        return;
    memcpy(&command, datagram, sizeof command);
    if (wrong) {
        answer = answer_to(&command.head, now, NPL_RESULT_WRONG_VERSION);
        send_to(from, &answer, sizeof answer);
        return;
    }
    int stops_for_any = kind == NPL_STOP && command.head.session == 0;
    if (key && !stops_for_any && !is_authentic(datagram, size, kind)) {
        answer = answer_to(&command.head, now, NPL_RESULT_NOT_AUTHENTIC);
        send_to(from, &answer, sizeof answer);
        return;
    }
    if (kind == NPL_HELLO) {
        npl_hello asked;
        memcpy(&asked, datagram, sizeof asked);
        int is_free = session == 0;
        answer = answer_to(&asked.head, now, hello(asked, from));
        if (is_free && session) /* only the first HELLO of a session is a sign of life */
            heard_ns = echo_in_ns = now, echo_ns = asked.head.sent_ns, last = answer;
        send_to(from, &answer, sizeof answer);
        return;
    }
    if (stops_for_any) {
        stop(session ? NPL_FAULT_FOREIGN_STOP : 0);
        stopper.sequence = stopper.until_ns > now ? stopper.sequence : 0;
        stopper.peer = from;
        stopper.until_ns = now + 500 * MS;
        stopper.echo_ns = command.head.sent_ns;
        stopper.number = command.head.number;
        stopper.version = command.head.version;
        answer = answer_to(&command.head, now, NPL_RESULT_ACCEPTED);
        send_to(from, &answer, sizeof answer);
        return;
    }
    if (session == 0 || command.head.session != session || !is_same(from, controller)) {
        int other = session && command.head.session == session;
        answer = answer_to(&command.head, now, other ? NPL_RESULT_BUSY : NPL_RESULT_OLD_SESSION);
        send_to(from, &answer, sizeof answer);
        return;
    }
    int is_newer = (int32_t)(command.head.sequence - sequence_in) > 0; /* else another datagram has overtaken it */
    if (is_newer) {
        missed += command.head.sequence - sequence_in - 1;
        sequence_in = command.head.sequence;
        echo_ns = command.head.sent_ns;
        echo_in_ns = now;
    }
    /* A late or overtaken datagram is no sign of life; nor is a STOP while an axis moves. */
    if (is_newer && (kind == NPL_STOP ? !is_moving() : kind == NPL_GOODBYE || command.deadline_ns >= now)) {
        heard_ns = now;
        if (command.silence_us >= SHORTEST_US && command.silence_us <= LONGEST_US)
            silence_us = command.silence_us;
    }
    if (kind == NPL_ALIVE)
        return;
    int32_t after = (int32_t)(command.head.number - number_in);
    if (after > 0) {
        uint16_t result = execute(&command, now);
        number_in = command.head.number;
        accepted = result == NPL_RESULT_ACCEPTED ? number_in : accepted;
        last = answer_to(&command.head, now, result);
    } else if (after < 0) {
        answer = answer_to(&command.head, now, NPL_RESULT_SUPERSEDED);
        send_to(from, &answer, sizeof answer);
        return;
    }
    send_to(from, &last, sizeof last);
    if (kind == NPL_GOODBYE)
        end_session();
}

static void tick(double seconds, uint64_t now) {
    int is_silent = session && now - heard_ns > silence_us * 1000ull, is_left = is_silent && is_moving();
    for (int which = 0; which < AXES; ++which) {
        axis_t *own = &axis[which];
        axis_tick(own, seconds);
        int moves = fabs(own->position - own->stood) > STILL[which];
        if (moves)
            moved_ns = now, own->stood = own->position;
        if (is_stopped && (moves || own->speed != 0))
            axis_stop(own); /* again: a drive may have missed the stop */
        if (!is_silent)
            own->silent = own->position;
        is_left |= fabs(own->position - own->silent) > LEFT[which];
        if (npl_range_beyond(&own->range, own->position, TOLERANCE[which]))
            stop(NPL_FAULT_BEYOND);
    }
    if (is_left && state == NPL_STATE_ENABLED)
        stop(NPL_FAULT_WATCHDOG);
    if (session && now - heard_ns > RELEASE_MS * MS)
        end_session();
    if (link_is_line && now < line_due_ns)
        return;
    line_due_ns = line_due_ns + LINE_NS > now ? line_due_ns + LINE_NS : now;
    if (now < stopper.until_ns && now >= stopper.due_ns) {
        npl_head head = {.sequence = ++stopper.sequence, .echo_ns = stopper.echo_ns, .number = stopper.number};
        stopper.due_ns = now + 5 * MS;
        send_status(stopper.peer, head, stopper.version, now);
        if (link_is_line)
            return;
    }
    if (session) {
        npl_head head = {.session = session, .sequence = ++statuses, .echo_ns = echo_ns,
                         .held_us = (uint32_t)((now - echo_in_ns) / 1000), .number = accepted};
        send_status(controller, head, limits.head.version, now);
    }
}

int main(int count, char **words) {
    uint64_t before = now_ns();
    key = count > 2 ? words[2] : NULL;
    if (link_open(count > 1 ? words[1] : "5005")) {
        perror("robot");
        return 1;
    }
    begin_ranges();
    for (;;) {
        uint8_t datagram[NPL_MOST];
        peer_t from;
        size_t size;
        while ((size = link_receive(datagram, &from)) > 0)
            receive(datagram, size, from, now_ns());
        uint64_t now = now_ns();
        tick((double)(now - before) / 1e9, now);
        before = now;
        nanosleep(&(struct timespec){0, 1000000}, NULL);
    }
}
