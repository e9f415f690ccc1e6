/* A hand-written codec for the layout of the C++ implementation (profile cpp-2.0), for comparison. */
#ifndef HANDWRITTEN_H
#define HANDWRITTEN_H
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    uint8_t sender[6];
    uint16_t network, length;
    uint8_t count;
    uint32_t seqno;
} hw_header;

typedef struct {
    double x, y, z;
    uint8_t node[6];
    int64_t stamp;
    uint32_t seqno;
} hw_report;

typedef struct {
    uint8_t id, producer[6], repetitions;
    int64_t created;
    uint16_t timeout;
    uint8_t descr_size, upd_id, seqno, size;
    const uint8_t *descr, *value;
} hw_create;

typedef struct {
    uint8_t id, seqno, size;
    const uint8_t *value;
} hw_update;

/* What is done with the contents: the same for both contenders. */
typedef struct {
    uint64_t sum;
} hw_sink;

bool hw_decode(const uint8_t *p, size_t size, hw_sink *sink);
size_t hw_encode(const uint8_t *from, size_t size, uint8_t *to, size_t room);
#endif
