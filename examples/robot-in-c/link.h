/* The link of a robot: UDP, or a serial line whose frames carry the same datagrams; for POSIX, in C99 without allocation.
 * On a controller without POSIX, write the functions link_receive and link_send for its UART: npl_frame and npl_unframe
 * of needleplan_robot.h make and find the frames. */
#ifndef ROBOT_LINK_H
#define ROBOT_LINK_H

#include <arpa/inet.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include "needleplan_robot.h"

/* Whom a datagram is from, or for: host and port; on a line, the port is the number of the sender, without a host. */
typedef struct {
    uint32_t host;
    uint16_t port;
} peer_t;

static int link_fd, link_is_line;

static int is_same(peer_t one, peer_t other) { return one.host == other.host && one.port == other.port; }

/* Open a UDP port of this machine, or the serial line at a path that begins with '/'. Return 0, or -1 for an error. */
static int link_open(const char *place) {
    struct sockaddr_in own = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    struct termios raw;
    link_is_line = place[0] == '/';
    if (link_is_line) {
        link_fd = open(place, O_RDWR | O_NOCTTY | O_NONBLOCK);
        if (link_fd < 0 || tcgetattr(link_fd, &raw))
            return -1;
        raw.c_iflag = raw.c_oflag = raw.c_lflag = 0;
        raw.c_cflag = CS8 | CREAD | CLOCAL;
        cfsetispeed(&raw, B460800);
        cfsetospeed(&raw, B460800);
        return tcsetattr(link_fd, TCSANOW, &raw);
    }
    own.sin_port = htons((uint16_t)atoi(place));
    link_fd = socket(AF_INET, SOCK_DGRAM, 0);
    if (link_fd < 0 || bind(link_fd, (struct sockaddr *)&own, sizeof own))
        return -1;
    return fcntl(link_fd, F_SETFL, O_NONBLOCK);
}

/* Receive the next datagram into `datagram` (NPL_MOST bytes), and its sender. Return its size, or 0: none has arrived. */
static size_t link_receive(uint8_t *datagram, peer_t *from) {
    static npl_unframer line;
    uint8_t byte;
    struct sockaddr_in sender;
    socklen_t length = sizeof sender;
    ssize_t size;
    while (link_is_line && read(link_fd, &byte, 1) == 1) {
        size_t found = npl_unframe(&line, byte);
        if (found && found <= NPL_MOST) {
            *from = (peer_t){0, line.bytes[0]};
            memcpy(datagram, line.bytes + 2, found);
            return found;
        }
    }
    while (!link_is_line) {
        size = recvfrom(link_fd, datagram, NPL_MOST, 0, (struct sockaddr *)&sender, &length);
        if (size < 0)
            return 0;
        *from = (peer_t){sender.sin_addr.s_addr, sender.sin_port};
        if (size > 0)
            return (size_t)size;
    }
    return 0;
}

/* Send a datagram; it is lost if there is no room. */
static void link_send(peer_t to, const uint8_t *datagram, size_t size) {
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = to.host, .sin_port = to.port};
    uint8_t out[NPL_FRAME];
    if (link_is_line)
        (void)!write(link_fd, out, npl_frame((uint8_t)to.port, datagram, size, out));
    else
        (void)!sendto(link_fd, datagram, size, 0, (struct sockaddr *)&address, sizeof address);
}

#endif
