#include "shaker_frame.h"

/* CRC-32 (polynomial 0xEDB88320, reflected) by half bytes: 64 bytes of table instead of 1024. */
static const uint32_t crc_of_half[16] = {
    0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
    0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
};

/* A packet on its way out: COBS needs the place of the last code byte, and how far it is. */
typedef struct {
    uint8_t *wire;
    size_t at;      /* next byte to write */
    size_t code_at; /* where the current group's code byte goes */
    uint8_t code;   /* its value so far */
    uint32_t crc;
} packet;

static void put_stuffed(packet *p, uint8_t byte)
{
    if (p->code == 0xFFu) { /* a full group of 254: closed only when something follows it */
        p->wire[p->code_at] = p->code;
        p->code_at = p->at++;
        p->code = 1;
    }
    if (byte == 0) {
        p->wire[p->code_at] = p->code;
        p->code_at = p->at++;
        p->code = 1;
    } else {
        p->wire[p->at++] = byte;
        p->code++;
    }
}

static void put(packet *p, uint8_t byte)
{
    p->crc = (p->crc >> 4) ^ crc_of_half[(p->crc ^ byte) & 0x0Fu];
    p->crc = (p->crc >> 4) ^ crc_of_half[(p->crc ^ (uint32_t)(byte >> 4)) & 0x0Fu];
    put_stuffed(p, byte);
}

static void put_number(packet *p, uint64_t value, unsigned bytes)
{
    while (bytes-- > 0) { /* least significant byte first, whatever the machine does */
        put(p, (uint8_t)(value & 0xFFu));
        value >>= 8;
    }
}

size_t shaker_frame_encode(uint8_t *wire, size_t room, const shaker_frame *frame, const int16_t *samples)
{
    const uint32_t values = (uint32_t)frame->rows * frame->channels;
    packet p = {wire, 1, 0, 1, 0xFFFFFFFFu};
    uint32_t i, crc;

    if (frame->channels == 0 || frame->channels > SHAKER_FRAME_MAX_CHANNELS || values == 0 ||
        values > SHAKER_FRAME_MAX_VALUES || room < SHAKER_FRAME_WIRE_BYTES(values))
        return 0;
    put(&p, (uint8_t)SHAKER_FRAME_VERSION);
    put(&p, frame->channels);
    put_number(&p, frame->rows, 2);
    put_number(&p, frame->sequence, 4);
    put_number(&p, frame->first_sample, 8);
    put_number(&p, frame->overruns, 4);
    for (i = 0; i < values; i++)
        put_number(&p, (uint16_t)samples[i], 2);
    crc = p.crc ^ 0xFFFFFFFFu;
    for (i = 0; i < 4; i++)
        put_stuffed(&p, (uint8_t)(crc >> (8 * i)));
    wire[p.code_at] = p.code;
    wire[p.at++] = 0;
    return p.at;
}
