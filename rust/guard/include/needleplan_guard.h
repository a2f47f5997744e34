/*
 * needleplan_guard.h: the safety guard of needleplan for C programs: what is decided between a sample and a STOP.
 *
 * The functions neither allocate, nor read a clock, nor keep anything between calls. Times are int64_t ns of one
 * monotonic clock, GUARD_NEVER where there is none. A set of causes is a uint64_t: bit n stands for cause number n.
 * Build the library from rust/guard with the feature "c"; docs/reference/safety.md has the rules.
 */
#ifndef NEEDLEPLAN_GUARD_H
#define NEEDLEPLAN_GUARD_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define GUARD_NEVER INT64_MIN
#define GUARD_SET(cause) (UINT64_C(1) << (cause))

/* Operating states, with the names of CRTK. */
enum { GUARD_DISABLED, GUARD_ENABLED, GUARD_PAUSED, GUARD_FAULT };

/* Owners of an order; an earlier one has more authority. */
enum { GUARD_PERSON, GUARD_ROBOT, GUARD_SENSOR, GUARD_LOOP, GUARD_NOBODY = 255 };

/* Orders. */
enum {
    GUARD_ENABLE, GUARD_DISABLE, GUARD_PAUSE, GUARD_RESUME, GUARD_RESET, GUARD_STOP, GUARD_HOME, GUARD_UNHOME,
    GUARD_MOVE, GUARD_RETRACT
};

/* Freshness of a device: a fresh usable sample; the device has failed; no fresh sample; no fresh sample is usable. */
enum { GUARD_FRESH, GUARD_FAILED_DEVICE, GUARD_STALE, GUARD_UNUSABLE };

/* Causes of stops and refusals. */
enum {
    GUARD_FORCE_STALE = 0,
    GUARD_FORCE_SUSPECT = 1,
    GUARD_FORCE_FAULT = 2,
    GUARD_FORCE_EXCEEDED = 3,
    GUARD_FORCE_RISING = 4,
    GUARD_POSE_STALE = 5,
    GUARD_POSE_SUSPECT = 6,
    GUARD_POSE_UNSEEN = 7,
    GUARD_POSE_JUMPED = 8,
    GUARD_POSE_FROZEN = 9,
    GUARD_POSE_FAULT = 10,
    GUARD_TIP_UNKNOWN = 11,
    GUARD_OUT_OF_PLANE = 12,
    GUARD_OUT_OF_WORKSPACE = 13,
    GUARD_IN_OBSTACLE = 14,
    GUARD_DEADMAN_RELEASED = 15,
    GUARD_STAGE_STALE = 16,
    GUARD_STAGE_SUSPECT = 17,
    GUARD_STAGE_FAULT = 18,
    GUARD_STAGE_JUMPED = 19,
    GUARD_DEPTH_EXCEEDED = 20,
    GUARD_ROLL_EXCEEDED = 21,
    GUARD_OVERSPEED = 22,
    GUARD_WRONG_WAY = 23,
    GUARD_NO_MOTION = 24,
    GUARD_STILL_MOVING = 25,
    GUARD_LOOP_LATE = 26,
    GUARD_CLOCK_MISMATCH = 27,
    GUARD_TIME_EXCEEDED = 28,
    GUARD_RECORDING_BEHIND = 29,
    GUARD_RECORDING_LOST = 30,
    GUARD_GUARD_FAILED = 31,
    GUARD_PLAN_LOST = 32,
    GUARD_STOP_ORDERED = 33,
    GUARD_NOT_POSSIBLE = 34,
    GUARD_NOT_AUTHORIZED = 35,
    GUARD_NOT_ENABLED = 36,
    GUARD_NOT_HOMED = 37,
    GUARD_NOT_RESET = 38,
    GUARD_NOT_FINITE = 39,
    GUARD_DEPTH_BEYOND = 40,
    GUARD_VELOCITY_BEYOND = 41,
    GUARD_ROLL_BEYOND = 42,
    GUARD_ROTATION_BEYOND = 43,
    GUARD_SECOND_COMMANDER = 44,
    GUARD_NOT_A_RETRACTION = 45,
    GUARD_LIMITS_IN_USE = 46
};

/* State of the guard. Keep it, and pass it to the next call. */
typedef struct {
    uint64_t present;   /* causes that are present */
    uint64_t latched;   /* causes that are latched until GUARD_RESET */
    uint64_t first;     /* causes of the last transition to FAULT or PAUSED, or of the STOP that ended a run */
    int64_t since_ns;   /* time at which `operating` was entered */
    uint8_t operating;
    uint8_t held_by;    /* owner who stopped, paused or retracted the needle */
    uint8_t motion;     /* owner of the motion in force; GUARD_PERSON for a retraction */
    uint8_t waits;      /* owner of a GUARD_ENABLE or GUARD_RESUME that waits for the needle to rest */
    uint8_t is_homed;   /* the zero of the stage is known */
    uint8_t is_busy;    /* the stage moves */
    uint8_t is_zero_lost; /* only a person may declare the zero known again */
    uint8_t is_stopping;  /* stopped, and not measured at rest since */
} guard_state;

/* The result of a validation of all inputs. */
typedef struct {
    uint64_t causes;
    uint8_t is_busy;       /* the stage moves */
    uint8_t is_retracting; /* the stage still carries out a retraction */
    uint8_t is_resting;    /* measured at rest after the last stop, and no stop or command is on its way */
} guard_report;

/* Next state, and what to do: first send a STOP if `stops`, then begin the motion. A refused order changes nothing. */
typedef struct {
    guard_state state;
    uint64_t causes;
    uint8_t stops;
    uint8_t moves;
    uint8_t retracts;
    uint8_t is_refused;
} guard_transition;

guard_state guard_begin(int64_t now_ns);
guard_transition guard_order(guard_state state, uint8_t order, uint8_t owner, int64_t now_ns);
guard_transition guard_validate(guard_state state, guard_report report, int64_t now_ns);

/* Limits of commands; the functions return the causes against a command, 0 if it is allowed. `here_mm` is the last known
 * depth, NAN if it is unknown. */
typedef struct {
    double shallowest_mm;
    double deepest_mm;
    double insertion_velocity_mm_s;
    double retraction_velocity_mm_s;
    double roll_rad;
    double rotation_velocity_rad_s;
} guard_command_limits;

uint64_t guard_against_insertion(guard_command_limits limits, double here_mm, double depth_mm, double velocity_mm_s);
uint64_t guard_against_retraction(guard_command_limits limits, double here_mm, double depth_mm, double velocity_mm_s);
uint64_t guard_against_rotation(guard_command_limits limits, double roll_rad, double velocity_rad_s);

/* Transport delay of the samples of a device with a clock; the last one was taken `late_s` before it was received. */
typedef struct {
    double late_s;
    double shortest_s;
    double received_s;
    double device_s;
} guard_delay;

guard_delay guard_delay_begin(void);
guard_delay guard_delay_then(guard_delay delay, int64_t received_ns, double device_s);

/* Freshness from the times at which the device took its last sample and its last usable sample. */
uint8_t guard_freshness(uint8_t has_failed, int64_t taken_ns, int64_t usable_ns, double limit_s, int64_t now_ns);
uint8_t guard_is_of_the_future(int64_t received_ns, int64_t now_ns);

/* Rise of the magnitude of the force above its minimum of the last 50 ms. A full window counts as exceeded. */
typedef struct {
    struct { int64_t time_ns; double force_n; } forces[512];
    size_t first;
    size_t count;
    double rise_n;
    int64_t unknown_until_ns;
} guard_force_rise;

void guard_force_rise_begin(guard_force_rise *rise);
void guard_force_rise_observe(guard_force_rise *rise, int64_t time_ns, double force_n);
uint8_t guard_force_rise_exceeds(const guard_force_rise *rise, double limit_n_s);
size_t guard_force_rise_size(void); /* equals sizeof(guard_force_rise), or header and library do not belong together */

/* A STOP that is repeated until the needle stands. */
typedef struct {
    int64_t arrived_ns;
    int64_t again_ns;
    uint32_t in_flight;
} guard_stop;

guard_stop guard_stop_none(void);
guard_stop guard_stop_begin(guard_stop stop); /* a STOP is about to be sent */
guard_stop guard_stop_end(guard_stop stop, int64_t sent_ns, int64_t now_ns, uint8_t has_arrived);
uint8_t guard_stop_is_due(guard_stop stop, int64_t now_ns);
uint8_t guard_stop_is_on_its_way(guard_stop stop);

uint8_t guard_heartbeat_is_due(int64_t sent_ns, int64_t now_ns);

/* The deadman switch. */
typedef struct { int64_t held_ns; } guard_deadman;

guard_deadman guard_deadman_begin(void);
guard_deadman guard_deadman_observe(guard_deadman deadman, uint8_t is_held, int64_t now_ns);
uint8_t guard_deadman_is_released(guard_deadman deadman, double limit_s, int64_t now_ns);

#ifdef __cplusplus
}
#endif

#endif
