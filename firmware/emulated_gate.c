/* One gate on an emulated RP2040, for the tests: the same calls as host_gate.c, by a box in memory that the emulator fills.
 *
 * Runs from the chip's memory without its boot code, clocks or peripherals: what is tried is the gate's machine code. */
#include "shaker_gate.h"

typedef struct {
    uint32_t call; /* 1 start, 2 bytes, 3 samples, 4 button, 5 status; 0 when it is done */
    uint32_t n;    /* bytes or samples of data; of a start the count to begin with */
    uint8_t data[8192];
} box_of_calls;

#define BOX ((volatile box_of_calls *)0x20030000u)

static shaker_gate gate;

void _start(void);

void _start(void)
{
    for (;;) {
        uint32_t i, n;
        uint8_t wire[SHAKER_GATE_STATUS_WIRE];

        while (BOX->call == 0)
            ;
        n = BOX->n;
        switch (BOX->call) {
        case 1:
            shaker_gate_init(&gate);
            gate.now = n;
            break;
        case 2:
            for (i = 0; i < n; i++)
                shaker_gate_byte(&gate, BOX->data[i]);
            break;
        case 3:
            for (i = 0; i < n; i++) {
                volatile int16_t *sample = (volatile int16_t *)BOX->data + i;
                *sample = shaker_gate_sample(&gate, *sample);
            }
            break;
        case 4:
            shaker_gate_button(&gate);
            break;
        case 5:
            n = (uint32_t)shaker_gate_status(&gate, wire);
            for (i = 0; i < n; i++)
                BOX->data[i] = wire[i];
            BOX->n = n;
            break;
        default:
            break;
        }
        BOX->call = 0;
    }
}
