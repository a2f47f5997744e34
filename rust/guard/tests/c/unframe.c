/* Reads the bytes of a serial line, and writes the frame of each datagram that it finds again. */
#include <stdio.h>

#include "needleplan_robot.h"

int main(void) {
    npl_unframer line = {0};
    uint8_t out[NPL_FRAME];
    int byte;
    while ((byte = getchar()) != EOF) {
        size_t size = npl_unframe(&line, (uint8_t)byte);
        if (size && size <= NPL_MOST)
            fwrite(out, 1, npl_frame(line.bytes[0], line.bytes + 2, size, out), stdout);
    }
    return 0;
}
