/* A run in C: home, enable, move, a stale force stops it, rest, reset, enable again; then the transitions of the file that
 * is named. Prints the line that fails. */
#include "needleplan_guard.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define CHECK(condition) \
    do { \
        if (!(condition)) { \
            printf("line %d: %s\n", __LINE__, #condition); \
            return 1; \
        } \
    } while (0)

static guard_force_rise rise;

static guard_state state_of(const int64_t *numbers)
{
    guard_state state;
    memset(&state, 0, sizeof state);
    state.operating = (uint8_t)numbers[0];
    state.is_homed = (uint8_t)numbers[1];
    state.is_busy = (uint8_t)numbers[2];
    state.present = (uint64_t)numbers[3];
    state.latched = (uint64_t)numbers[4];
    state.since_ns = numbers[5];
    state.held_by = (uint8_t)numbers[6]; /* -1: GUARD_NOBODY */
    state.motion = (uint8_t)numbers[7];
    state.is_zero_lost = (uint8_t)numbers[8];
    state.first = (uint64_t)numbers[9];
    state.is_stopping = (uint8_t)numbers[10];
    state.waits = (uint8_t)numbers[11];
    return state;
}

static int is_same(guard_state one, guard_state other)
{
    return one.present == other.present && one.latched == other.latched && one.first == other.first
        && one.since_ns == other.since_ns && one.operating == other.operating && one.held_by == other.held_by
        && one.motion == other.motion && one.waits == other.waits && one.is_homed == other.is_homed
        && one.is_busy == other.is_busy && one.is_zero_lost == other.is_zero_lost
        && one.is_stopping == other.is_stopping;
}

static int transitions(const char *name)
{
    FILE *file = fopen(name, "r");
    char line[1024], *next;
    int count = 0, place;
    CHECK(file);
    while (fgets(line, sizeof line, file)) {
        int64_t numbers[34];
        guard_report report;
        guard_transition step;
        for (place = 0, next = line; place < 34; place++, next++)
            numbers[place] = strtoll(next, &next, 10);
        memset(&report, 0, sizeof report);
        report.causes = (uint64_t)numbers[13];
        report.is_busy = (uint8_t)numbers[14];
        report.is_retracting = (uint8_t)numbers[15];
        report.is_resting = (uint8_t)numbers[16];
        step = numbers[12] < 0
            ? guard_validate(state_of(numbers), report, numbers[17])
            : guard_order(state_of(numbers), (uint8_t)numbers[12], (uint8_t)numbers[13], numbers[17]);
        CHECK(step.is_refused == numbers[18] && step.stops == numbers[19] && step.causes == (uint64_t)numbers[21]);
        CHECK(step.moves == (numbers[20] == 0) && step.retracts == (numbers[20] == 1));
        CHECK(is_same(step.state, state_of(numbers + 22)));
        count++;
    }
    fclose(file);
    CHECK(count == 2000);
    return 0;
}

int main(int arguments, char **words)
{
    guard_state state = guard_begin(1);
    guard_report report, stale;
    guard_transition step;
    guard_command_limits limits = {-100, 150, 10, 20, 25, 12};
    guard_delay delay;
    guard_stop stop;
    guard_deadman deadman;
    int number;

    CHECK(arguments == 2 && transitions(words[1]) == 0);
    CHECK(state.since_ns == 1 && state.operating == GUARD_DISABLED && !state.is_homed);
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
    step = guard_order(state, 10, GUARD_PERSON, 9);
    CHECK(step.is_refused && step.causes == GUARD_SET(GUARD_NOT_POSSIBLE) && is_same(step.state, state));
    CHECK(guard_order(state, GUARD_HOME, 4, 9).is_refused);
    state.held_by = 4;
    CHECK(guard_order(state, GUARD_HOME, GUARD_PERSON, 9).state.latched == GUARD_SET(GUARD_GUARD_FAILED));
    CHECK(guard_validate(state, report, 9).stops);
    state.held_by = GUARD_NOBODY;
    state.operating = 4;
    step = guard_order(state, GUARD_HOME, GUARD_PERSON, 9);
    CHECK(step.stops && step.state.operating == GUARD_FAULT);
    CHECK(step.state.latched == GUARD_SET(GUARD_GUARD_FAILED) && step.state.is_zero_lost && !step.state.is_homed);
    state.operating = GUARD_PAUSED;
    report.causes = GUARD_SET(63);
    CHECK(guard_validate(state, report, 9).state.present == GUARD_SET(GUARD_GUARD_FAILED));

    CHECK(guard_against_insertion(limits, 0, 20, 10) == 0);
    CHECK(guard_against_insertion(limits, 0, 20, 11) == GUARD_SET(GUARD_VELOCITY_BEYOND));
    CHECK(guard_against_insertion(limits, NAN, -100, 20) == GUARD_SET(GUARD_VELOCITY_BEYOND));
    CHECK(guard_against_retraction(limits, NAN, 0, 5) == GUARD_SET(GUARD_NOT_A_RETRACTION));
    CHECK(guard_against_retraction(limits, 5, 5, 20) == 0);
    CHECK(guard_against_rotation(limits, NAN, 5) == GUARD_SET(GUARD_NOT_FINITE));

    delay = guard_delay_then(guard_delay_then(guard_delay_begin(), 1000000000, 5.0), 1200000000, 5.1);
    CHECK(fabs(delay.late_s - 0.1) < 1e-4);
    CHECK(guard_freshness(0, 0, GUARD_NEVER, 0.03, 30000000) == GUARD_UNUSABLE);
    CHECK(guard_freshness(0, 0, 0, 0.03, 30000001) == GUARD_STALE);
    CHECK(guard_freshness(1, 0, 0, 0.03, 0) == GUARD_FAILED_DEVICE && guard_freshness(0, 0, 0, 0.03, 0) == GUARD_FRESH);
    CHECK(guard_is_of_the_future(5000001, 0) && !guard_is_of_the_future(GUARD_NEVER, 0));

    CHECK(guard_force_rise_size() == sizeof rise);
    memset(&rise, 0xFF, sizeof rise);
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
    stop = guard_stop_end(guard_stop_begin(stop), 0, 1, 0);
    CHECK(stop.arrived_ns == GUARD_NEVER && guard_stop_is_on_its_way(stop));
    CHECK(!guard_heartbeat_is_due(0, 4499999) && guard_heartbeat_is_due(0, 4500000));

    CHECK(guard_deadman_is_released(guard_deadman_begin(), 0.2, 0));
    CHECK(guard_deadman_is_released(guard_deadman_observe(guard_deadman_begin(), 0, 0), 0.2, 0));
    deadman = guard_deadman_observe(guard_deadman_begin(), 1, 0);
    CHECK(!guard_deadman_is_released(deadman, 0.2, 200000000) && guard_deadman_is_released(deadman, 0.2, 200000001));
    return 0;
}
