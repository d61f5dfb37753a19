/* Packets on a serial line: bytes, their CRC-32, stuffed by COBS and ended by a zero. Portable C99, without the C library,
 * without a heap.
 *
 * The rule: whatever bytes come, a packet is taken whole or not at all. */
#ifndef SHAKER_PACKET_H
#define SHAKER_PACKET_H

#include <stddef.h>
#include <stdint.h>

#define SHAKER_MESSAGE_BYTES 32u /* longest packet that is read, its CRC-32 included */

/* A packet on its way out: COBS needs the place of the last code byte, and how far it is. */
typedef struct {
    uint8_t *wire;
    size_t at;      /* next byte to write */
    size_t code_at; /* where the current group's code byte goes */
    uint8_t code;   /* its value so far */
    uint32_t crc;
} shaker_packet;

void shaker_packet_begin(shaker_packet *p, uint8_t *wire);
void shaker_packet_number(shaker_packet *p, uint64_t value, unsigned bytes); /* least significant byte first */
size_t shaker_packet_end(shaker_packet *p); /* bytes on the wire, the zero included */

/* A packet on its way in. */
typedef struct {
    uint8_t data[SHAKER_MESSAGE_BYTES];
    uint8_t n;    /* bytes of data so far */
    uint8_t left; /* bytes that the current group still has */
    uint8_t code; /* length of the current group; 0 before the first */
    uint8_t bad;  /* too long: skipped up to the next zero */
} shaker_unpacker;

/* One more byte; the length of the packet without its CRC-32 where this byte ended a whole one, otherwise 0. */
uint8_t shaker_unpack(shaker_unpacker *u, uint8_t byte);

#endif
