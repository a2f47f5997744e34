/* A run in C: home, enable, move, a stale force stops it, rest, reset, enable again. Prints the line that fails. */
#include "needleplan_guard.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define CHECK(condition) \
    do { \
        if (!(condition)) { \
            printf("line %d: %s\n", __LINE__, #condition); \
            return 1; \
        } \
    } while (0)

static guard_force_rise rise;

int main(void)
{
    guard_state state = guard_begin(1);
    guard_report report, stale;
    guard_transition step;
    guard_command_limits limits = {-100, 150, 10, 20, 25, 12};
    guard_delay delay;
    guard_stop stop;
    guard_deadman deadman;
    int number;

    memset(&report, 0, sizeof report);
    stale = report;
    stale.causes = GUARD_SET(GUARD_FORCE_STALE);

    step = guard_order(state, GUARD_ENABLE, GUARD_LOOP, 2);
    CHECK(step.is_refused && step.causes == GUARD_SET(GUARD_NOT_HOMED));
    state = guard_order(state, GUARD_HOME, GUARD_LOOP, 3).state;
    state = guard_order(state, GUARD_ENABLE, GUARD_LOOP, 4).state;
    CHECK(state.operating == GUARD_ENABLED && state.since_ns == 4 && state.held_by == GUARD_NOBODY);
    step = guard_order(state, GUARD_MOVE, GUARD_LOOP, 5);
    CHECK(step.moves && !step.stops && !step.retracts);
    step = guard_validate(step.state, stale, 6);
    CHECK(step.stops && step.state.operating == GUARD_FAULT && step.state.held_by == GUARD_SENSOR);
    CHECK(step.state.latched == stale.causes && step.state.is_stopping);
    report.is_resting = 1;
    state = guard_validate(step.state, report, 7).state;
    CHECK(state.operating == GUARD_DISABLED && !state.is_stopping);
    CHECK(guard_order(state, GUARD_ENABLE, GUARD_PERSON, 8).is_refused);
    CHECK(guard_order(state, GUARD_RESET, GUARD_LOOP, 8).is_refused);
    state = guard_order(state, GUARD_RESET, GUARD_PERSON, 8).state;
    CHECK(guard_order(state, GUARD_ENABLE, GUARD_LOOP, 9).state.operating == GUARD_ENABLED);

    /* What cannot be stops the needle, or is refused. */
    CHECK(guard_order(state, 10, GUARD_PERSON, 9).is_refused && guard_order(state, GUARD_HOME, 4, 9).is_refused);
    state.operating = 4;
    step = guard_order(state, GUARD_HOME, GUARD_PERSON, 9);
    CHECK(step.stops && step.state.operating == GUARD_FAULT);
    CHECK(step.state.latched == GUARD_SET(GUARD_GUARD_FAILED) && step.state.is_zero_lost && !step.state.is_homed);
    state.operating = GUARD_PAUSED;
    report.causes = GUARD_SET(63);
    CHECK(guard_validate(state, report, 9).state.present == GUARD_SET(GUARD_GUARD_FAILED));

    CHECK(guard_against_insertion(limits, 0, 20, 10) == 0);
    CHECK(guard_against_insertion(limits, 0, 20, 11) == GUARD_SET(GUARD_VELOCITY_BEYOND));
    CHECK(guard_against_retraction(limits, NAN, 0, 5) == GUARD_SET(GUARD_NOT_A_RETRACTION));
    CHECK(guard_against_rotation(limits, NAN, 5) == GUARD_SET(GUARD_NOT_FINITE));

    delay = guard_delay_then(guard_delay_then(guard_delay_begin(), 1000000000, 5.0), 1200000000, 5.1);
    CHECK(fabs(delay.late_s - 0.1) < 1e-4);
    CHECK(guard_freshness(0, 0, GUARD_NEVER, 0.03, 30000000) == GUARD_UNUSABLE);
    CHECK(guard_freshness(0, 0, 0, 0.03, 30000001) == GUARD_STALE);
    CHECK(guard_is_of_the_future(5000001, 0) && !guard_is_of_the_future(GUARD_NEVER, 0));

    CHECK(guard_force_rise_size() == sizeof rise);
    guard_force_rise_begin(&rise);
    CHECK(!guard_force_rise_exceeds(&rise, 50));
    for (number = 0; number < 513; number++)
        guard_force_rise_observe(&rise, number * INT64_C(50000), number * 1e-6);
    CHECK(guard_force_rise_exceeds(&rise, 1e9) && isinf(rise.rise_n));
    CHECK(guard_force_rise_exceeds(NULL, 50));
    guard_force_rise_begin(NULL);
    guard_force_rise_observe(NULL, 0, 0);

    stop = guard_stop_begin(guard_stop_none());
    CHECK(guard_stop_is_on_its_way(stop) && !guard_stop_is_due(stop, INT64_MAX));
    stop = guard_stop_end(stop, 0, 1000000, 1);
    CHECK(stop.arrived_ns == 1000000 && !guard_stop_is_on_its_way(stop));
    CHECK(!guard_stop_is_due(stop, 20999999) && guard_stop_is_due(stop, 21000000));
    CHECK(!guard_heartbeat_is_due(0, 4499999) && guard_heartbeat_is_due(0, 4500000));

    deadman = guard_deadman_observe(guard_deadman_begin(), 1, 0);
    CHECK(!guard_deadman_is_released(deadman, 0.2, 200000000) && guard_deadman_is_released(deadman, 0.2, 200000001));
    return 0;
}
