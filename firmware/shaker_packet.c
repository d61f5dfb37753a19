#include "shaker_packet.h"

/* CRC-32 (polynomial 0xEDB88320, reflected) by half bytes: 64 bytes of table instead of 1024. */
static const uint32_t crc_of_half[16] = {
    0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
    0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
};

static uint32_t crc_with(uint32_t crc, uint8_t byte)
{
    crc = (crc >> 4) ^ crc_of_half[(crc ^ byte) & 0x0Fu];
    return (crc >> 4) ^ crc_of_half[(crc ^ (uint32_t)(byte >> 4)) & 0x0Fu];
}

static void put_stuffed(shaker_packet *p, uint8_t byte)
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

void shaker_packet_begin(shaker_packet *p, uint8_t *wire)
{
    p->wire = wire;
    p->at = 1;
    p->code_at = 0;
    p->code = 1;
    p->crc = 0xFFFFFFFFu;
}

void shaker_packet_number(shaker_packet *p, uint64_t value, unsigned bytes)
{
    while (bytes-- > 0) { /* least significant byte first, whatever the machine does */
        uint8_t byte = (uint8_t)(value & 0xFFu);
        p->crc = crc_with(p->crc, byte);
        put_stuffed(p, byte);
        value >>= 8;
    }
}

size_t shaker_packet_end(shaker_packet *p)
{
    uint32_t crc = p->crc ^ 0xFFFFFFFFu;
    unsigned i;

    for (i = 0; i < 4; i++)
        put_stuffed(p, (uint8_t)(crc >> (8 * i)));
    p->wire[p->code_at] = p->code;
    p->wire[p->at++] = 0;
    return p->at;
}

static void take_in(shaker_unpacker *u, uint8_t byte)
{
    if (u->n == SHAKER_MESSAGE_BYTES)
        u->bad = 1;
    else
        u->data[u->n++] = byte;
}

uint8_t shaker_unpack(shaker_unpacker *u, uint8_t byte)
{
    uint8_t n = 0;

    if (byte != 0) {
        if (u->left > 0) {
            u->left--;
            take_in(u, byte);
        } else { /* a group begins; the one before ended with a zero that was not sent */
            if (u->code != 0 && u->code != 0xFFu)
                take_in(u, 0);
            u->code = byte;
            u->left = (uint8_t)(byte - 1);
        }
        return 0;
    }
    if (!u->bad && u->left == 0 && u->n > 4) {
        uint32_t crc = 0xFFFFFFFFu;
        uint32_t sent = 0;
        uint8_t i;
        n = (uint8_t)(u->n - 4);
        for (i = 0; i < n; i++)
            crc = crc_with(crc, u->data[i]);
        for (i = 4; i > 0; i--)
            sent = (sent << 8) | u->data[n + i - 1];
        if ((crc ^ 0xFFFFFFFFu) != sent)
            n = 0;
    }
    u->n = u->left = u->code = u->bad = 0;
    return n;
}
