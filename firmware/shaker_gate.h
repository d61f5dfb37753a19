/* The gate in the drive's way that no crash of the host can hold open. Portable C99: integers only, no C library, no heap.
 *
 * Each sample of the drive passes through `shaker_gate_sample`. The host keeps the gate open by heartbeats. Each answers
 * a count that the gate sent, and is worth one cycle of the forcing from that count on: heartbeats that were waiting in a
 * buffer when the host died are worth nothing. Without one, or beyond a limit, the drive fades to zero, and the gate
 * stays closed until a person presses its button: no message opens it again.
 *
 * The rule: from the last sign of life to a drive of exactly zero two cycles pass at most. A cycle for the
 * heartbeat to be missed, three quarters of one for the fade, a quarter for what the limit of slew leaves to do. */
#ifndef SHAKER_GATE_H
#define SHAKER_GATE_H

#include <stddef.h>
#include <stdint.h>

#include "shaker_packet.h"

#define SHAKER_GATE_VERSION 1u
#define SHAKER_GATE_CYCLE_LEAST 16u  /* samples in a cycle of the forcing */
#define SHAKER_GATE_CYCLE_MOST 8192u
#define SHAKER_GATE_MOST 32767u      /* largest amplitude that a host may ask for, in codes; lower it for your rig */
#define SHAKER_GATE_STATUS_WIRE 24u  /* room for a status on the wire */

enum { SHAKER_GATE_REST, SHAKER_GATE_OPEN, SHAKER_GATE_FADING, SHAKER_GATE_LATCHED };
enum { SHAKER_GATE_NO_CAUSE, SHAKER_GATE_HEARTBEAT, SHAKER_GATE_AMPLITUDE, SHAKER_GATE_SLEW };
enum { SHAKER_GATE_ARM = 1, SHAKER_GATE_BEAT = 2, SHAKER_GATE_END = 3, SHAKER_GATE_STATUS = 128 }; /* messages */

typedef struct {
    uint32_t now;   /* samples since the start; wraps */
    uint32_t until; /* count up to which the last heartbeat is worth */
    uint16_t cycle; /* samples */
    uint16_t limit; /* largest amplitude, codes */
    uint16_t slew;  /* largest change from one sample to the next, codes */
    uint16_t place; /* samples of the rise, or of the fade, that have passed */
    int32_t gain;   /* 0 to 32768; of a fade the one that it began with */
    int16_t out;
    uint8_t state;
    uint8_t cause;
    shaker_unpacker in;
} shaker_gate;

void shaker_gate_init(shaker_gate *g);
void shaker_gate_byte(shaker_gate *g, uint8_t byte);         /* a byte came from the host */
int16_t shaker_gate_sample(shaker_gate *g, int16_t drive);   /* one sample of the drive, every period of the clock */
void shaker_gate_button(shaker_gate *g);                     /* a person pressed the button */
size_t shaker_gate_status(const shaker_gate *g, uint8_t *wire); /* what to send, at least four times a cycle */

#endif
