/* Serial frames of a sampling device: reference encoder in portable C99, without the C library and without a heap.
 *
 * The rule: one pass, one buffer. A frame goes out as it is built; nothing is allocated, nothing blocks.
 * The format is described in docs/serial-frame.md; the decoder is daq/serial_frames.py. */
#ifndef SHAKER_FRAME_H
#define SHAKER_FRAME_H

#include <stddef.h>
#include <stdint.h>

#define SHAKER_FRAME_VERSION 1u
#define SHAKER_FRAME_HEADER_BYTES 20u
#define SHAKER_FRAME_MAX_CHANNELS 16u
#define SHAKER_FRAME_MAX_VALUES 2048u

/* Bytes on the wire of a frame with `values` int16 values, COBS and delimiter included. */
#define SHAKER_FRAME_PACKET_BYTES(values) (SHAKER_FRAME_HEADER_BYTES + 2u * (values) + 4u)
#define SHAKER_FRAME_WIRE_BYTES(values) \
    (SHAKER_FRAME_PACKET_BYTES(values) + SHAKER_FRAME_PACKET_BYTES(values) / 254u + 2u)

typedef struct {
    uint8_t channels;      /* values in a row, 1 .. SHAKER_FRAME_MAX_CHANNELS */
    uint16_t rows;         /* at least 1; rows * channels <= SHAKER_FRAME_MAX_VALUES */
    uint32_t sequence;     /* number of this frame since the device started; wraps */
    uint64_t first_sample; /* counter of conversions at the first row; dropped ones counted */
    uint32_t overruns;     /* conversions dropped since the device started; wraps */
} shaker_frame;

/* Write the frame to `wire`; `samples` holds rows * channels values, row by row.
 * Returns the number of bytes, the delimiter included; 0 where a count is out of range or `room` is too small. */
size_t shaker_frame_encode(uint8_t *wire, size_t room, const shaker_frame *frame, const int16_t *samples);

#endif
