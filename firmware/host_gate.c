/* One gate in a library on the host, for the tests: bytes and samples in, samples and bytes out. */
#include "shaker_gate.h"

static shaker_gate gate;

void gate_start(uint32_t now)
{
    shaker_gate_init(&gate);
    gate.now = now;
}

void gate_bytes(const uint8_t *bytes, size_t n)
{
    while (n-- > 0)
        shaker_gate_byte(&gate, *bytes++);
}

void gate_samples(const int16_t *drive, int16_t *out, size_t n)
{
    while (n-- > 0)
        *out++ = shaker_gate_sample(&gate, *drive++);
}

void gate_press(void)
{
    shaker_gate_button(&gate);
}

size_t gate_status(uint8_t *wire)
{
    return shaker_gate_status(&gate, wire);
}
