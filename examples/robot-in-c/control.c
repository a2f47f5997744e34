/* The control side of the robot protocol for POSIX, in C99 without allocation:
 *
 *     control PORT [KEY]
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
#include "tag.h"

/* Times, which tests on a busy machine make longer. */
#ifndef VALID_NS
#define VALID_NS 100000000u /* from sending a command to its deadline */
#define SILENCE_US 100000u  /* watchdog time of the robot */
#endif

static int robot_link;
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
    uint8_t out[NPL_MOST], tag[NPL_TAG];
    npl_head *head = message;
    head->session = session;
    head->sequence = ++sequence;
    head->sent_ns = now_ns();
    if (key) {
        head->size = (uint16_t)(size + NPL_TAG);
        npl_tag(key, nonce, message, size - 4, tag);
        size = npl_seal_tagged(message, size, tag, out);
    } else {
        npl_seal(message, size);
        memcpy(out, message, size);
    }
    if (send(robot_link, out, size, 0) < 0)
        perror("send");
}

/* Receive for 5 ms, however many statuses come. Return the result of the answer to command `about`, or -1. */
static int receive(uint32_t about) {
    struct pollfd ready = {robot_link, POLLIN, 0};
    const uint64_t end_ns = now_ns() + 5000000u;
    for (uint64_t now = now_ns(); now < end_ns; now = now_ns()) {
        if (poll(&ready, 1, (int)((end_ns - now) / 1000000u) + 1) <= 0)
            break;
        uint8_t data[256];
        ssize_t length = recv(robot_link, data, sizeof data, 0);
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
            hello.silence_us = SILENCE_US;
            transmit(&hello, sizeof hello);
        } else {
            npl_command command = {0};
            npl_begin(&command.head, kind, sizeof command);
            command.head.number = number;
            command.deadline_ns = robot_ns + (now_ns() - heard_ns) + VALID_NS;
            command.target = target;
            command.speed = speed;
            command.silence_us = SILENCE_US;
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
    robot_link = socket(AF_INET, SOCK_DGRAM, 0);
    if (connect(robot_link, (struct sockaddr *)&robot, sizeof robot) != 0)
        return 2;
    order("hello", NPL_HELLO, 0, 0);
    order("reset", NPL_RESET, 0, 0);
    order("enable", NPL_ENABLE, 0, 0);
    order("insert 9 mm", NPL_INSERT, 9, 5);
    int accepted = order("insert 2 mm", NPL_INSERT, 2, 5) == 0;
    for (int turn = 0; accepted && turn < 2000 && ((status.flags & NPL_MOVING) || status.depth_mm < 1.99); ++turn) {
        npl_command alive = {0};
        npl_begin(&alive.head, NPL_ALIVE, sizeof alive);
        alive.deadline_ns = robot_ns + (now_ns() - heard_ns) + VALID_NS;
        alive.silence_us = SILENCE_US;
        transmit(&alive, sizeof alive);
        receive(0);
    }
    printf("depth %.2f faults %u\n", status.depth_mm, status.faults);
    order("goodbye", NPL_GOODBYE, 0, 0);
    close(robot_link);
    return 0;
}
