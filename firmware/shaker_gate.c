#include "shaker_gate.h"

/* 3 x^2 - 2 x^3 of x = at / of, in parts of 32768: rises from 0 to 32768 without a corner at either end. */
static int32_t smooth(uint16_t at, uint16_t of)
{
    uint32_t x = ((uint32_t)at << 15) / of;
    uint32_t square = (x * x) >> 15;

    return (int32_t)((square * (3u * 32768u - 2u * x)) >> 15);
}

static void close_for(shaker_gate *g, uint8_t cause)
{
    if (g->state != SHAKER_GATE_OPEN)
        return;
    g->state = SHAKER_GATE_FADING;
    g->cause = cause;
    g->place = 0;
}

void shaker_gate_init(shaker_gate *g)
{
    static const shaker_gate nothing = {0};

    *g = nothing;
}

void shaker_gate_button(shaker_gate *g)
{
    if (g->state == SHAKER_GATE_LATCHED) {
        g->state = SHAKER_GATE_REST;
        g->cause = SHAKER_GATE_NO_CAUSE;
    }
}

static uint32_t number(const uint8_t *bytes, unsigned n)
{
    uint32_t value = 0;

    while (n-- > 0)
        value = (value << 8) | bytes[n];
    return value;
}

void shaker_gate_byte(shaker_gate *g, uint8_t byte)
{
    const uint8_t n = shaker_unpack(&g->in, byte);
    const uint8_t *data = g->in.data;
    uint32_t seen;

    if (n < 6 || data[0] != SHAKER_GATE_VERSION)
        return;
    seen = number(data + 2, 4); /* the count that the host answers */
    if (data[1] == SHAKER_GATE_ARM && n == 12 && g->state == SHAKER_GATE_REST) {
        const uint32_t cycle = number(data + 6, 2), limit = number(data + 8, 2), slew = number(data + 10, 2);
        if (cycle < SHAKER_GATE_CYCLE_LEAST || cycle > SHAKER_GATE_CYCLE_MOST || g->now - seen >= cycle || limit == 0 ||
            limit > SHAKER_GATE_MOST || slew > SHAKER_GATE_MOST || limit > slew * (cycle / 4u))
            return;
        g->cycle = (uint16_t)cycle;
        g->limit = (uint16_t)limit;
        g->slew = (uint16_t)slew;
        g->until = seen + cycle;
        g->place = 0;
        g->gain = 0;
        g->state = SHAKER_GATE_OPEN;
    } else if (data[1] == SHAKER_GATE_BEAT && n == 6 && g->state == SHAKER_GATE_OPEN) {
        /* neither older than a cycle, nor from the future, nor less than what it was worth already */
        if (g->now - seen < g->cycle && (int32_t)(seen + g->cycle - g->until) > 0)
            g->until = seen + g->cycle;
    } else if (data[1] == SHAKER_GATE_END && n == 6) {
        close_for(g, SHAKER_GATE_NO_CAUSE); /* from a host that may be mistaken: closing is always right */
    }
}

int16_t shaker_gate_sample(shaker_gate *g, int16_t drive)
{
    int32_t wanted = 0, step;

    g->now++;
    if (g->state == SHAKER_GATE_OPEN && (int32_t)(g->now - g->until) >= 0)
        close_for(g, SHAKER_GATE_HEARTBEAT);
    if (g->state == SHAKER_GATE_OPEN) {
        if (g->place < g->cycle)
            g->gain = smooth(++g->place, g->cycle);
        wanted = drive * g->gain / 32768;
        if (wanted > g->limit || wanted < -(int32_t)g->limit)
            close_for(g, SHAKER_GATE_AMPLITUDE);
        else if (wanted - g->out > g->slew || g->out - wanted > g->slew)
            close_for(g, SHAKER_GATE_SLEW);
    } else if (g->state == SHAKER_GATE_FADING) {
        const uint16_t fade = (uint16_t)(3u * g->cycle / 4u);
        if (g->place < fade)
            wanted = drive * (g->gain * (32768 - smooth(++g->place, fade)) / 32768) / 32768;
        else if (g->out == 0)
            g->state = g->cause == SHAKER_GATE_NO_CAUSE ? SHAKER_GATE_REST : SHAKER_GATE_LATCHED;
    }
    if (g->state == SHAKER_GATE_REST || g->state == SHAKER_GATE_LATCHED)
        return g->out = 0;
    if (wanted > g->limit)
        wanted = g->limit;
    if (wanted < -(int32_t)g->limit)
        wanted = -(int32_t)g->limit;
    step = wanted - g->out;
    if (step > g->slew)
        step = g->slew;
    if (step < -(int32_t)g->slew)
        step = -(int32_t)g->slew;
    g->out = (int16_t)(g->out + step);
    return g->out;
}

size_t shaker_gate_status(const shaker_gate *g, uint8_t *wire)
{
    shaker_packet p;

    shaker_packet_begin(&p, wire);
    shaker_packet_number(&p, SHAKER_GATE_VERSION, 1);
    shaker_packet_number(&p, SHAKER_GATE_STATUS, 1);
    shaker_packet_number(&p, g->now, 4);
    shaker_packet_number(&p, g->state, 1);
    shaker_packet_number(&p, g->cause, 1);
    return shaker_packet_end(&p);
}
