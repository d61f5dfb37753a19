/* The encoder as a filter on the host, for the tests: frames in (header, then samples, in the order and byte order of
 * docs/serial-frame.md), wire bytes out. */
#include <stdio.h>

#include "shaker_frame.h"

static uint64_t number(const uint8_t *bytes, unsigned n)
{
    uint64_t value = 0;
    while (n-- > 0)
        value = (value << 8) | bytes[n];
    return value;
}

int main(void)
{
    static uint8_t in[2 * SHAKER_FRAME_MAX_VALUES], wire[SHAKER_FRAME_WIRE_BYTES(SHAKER_FRAME_MAX_VALUES)];
    static int16_t samples[SHAKER_FRAME_MAX_VALUES];
    uint8_t head[SHAKER_FRAME_HEADER_BYTES];

    while (fread(head, 1, sizeof head, stdin) == sizeof head) {
        shaker_frame frame = {0};
        size_t values, i, n;
        frame.channels = head[1];
        frame.rows = (uint16_t)number(head + 2, 2);
        frame.sequence = (uint32_t)number(head + 4, 4);
        frame.first_sample = number(head + 8, 8);
        frame.overruns = (uint32_t)number(head + 16, 4);
        values = (size_t)frame.rows * frame.channels;
        if (values > SHAKER_FRAME_MAX_VALUES || fread(in, 2, values, stdin) != values)
            return 1;
        for (i = 0; i < values; i++)
            samples[i] = (int16_t)(uint16_t)number(in + 2 * i, 2);
        n = shaker_frame_encode(wire, sizeof wire, &frame, samples);
        if (n == 0 || fwrite(wire, 1, n, stdout) != n)
            return 1;
    }
    return fflush(stdout) == 0 ? 0 : 1;
}
