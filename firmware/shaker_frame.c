#include "shaker_frame.h"

#include "shaker_packet.h"

size_t shaker_frame_encode(uint8_t *wire, size_t room, const shaker_frame *frame, const int16_t *samples)
{
    const uint32_t values = (uint32_t)frame->rows * frame->channels;
    shaker_packet p;
    uint32_t i;

    if (frame->channels == 0 || frame->channels > SHAKER_FRAME_MAX_CHANNELS || values == 0 ||
        values > SHAKER_FRAME_MAX_VALUES || room < SHAKER_FRAME_WIRE_BYTES(values))
        return 0;
    shaker_packet_begin(&p, wire);
    shaker_packet_number(&p, SHAKER_FRAME_VERSION, 1);
    shaker_packet_number(&p, frame->channels, 1);
    shaker_packet_number(&p, frame->rows, 2);
    shaker_packet_number(&p, frame->sequence, 4);
    shaker_packet_number(&p, frame->first_sample, 8);
    shaker_packet_number(&p, frame->overruns, 4);
    for (i = 0; i < values; i++)
        shaker_packet_number(&p, (uint16_t)samples[i], 2);
    return shaker_packet_end(&p);
}
