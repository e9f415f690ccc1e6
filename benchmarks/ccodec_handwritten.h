/* A hand-written codec for the layout of the C++ implementation (profile cpp-2.0), for comparison: functions that read
 * and write one part each, with structures of the caller, as the generated codec has them. It is for little-endian
 * processors, as the implementation is. */
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
    uint16_t protocol, length;
    const uint8_t *content;
} hw_block;

typedef struct {
    double x, y, z;
    uint8_t node[6];
    int64_t stamp;
    uint32_t seqno;
    uint8_t gaps[22];
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

typedef struct {
    uint8_t id, seqno;
} hw_pair;

typedef struct {
    const uint8_t *p, *end;
} hw_reader;

typedef struct {
    uint8_t *p, *end;
} hw_writer;

/* All return false if the octets or the room do not suffice, or a value is wrong. */
bool hw_get_header(hw_reader *r, hw_header *h);
bool hw_get_block(hw_reader *r, hw_block *b);
bool hw_get_report(const hw_block *b, hw_report *report);
bool hw_get_container(hw_reader *r, uint8_t *type, uint8_t *count);
bool hw_get_pair(hw_reader *r, hw_pair *pair);
bool hw_get_id(hw_reader *r, uint8_t *id);
bool hw_get_update(hw_reader *r, hw_update *u);
bool hw_get_create(hw_reader *r, hw_create *c);

bool hw_put_header(hw_writer *w, const hw_header *h);
bool hw_put_block(hw_writer *w, uint16_t protocol, uint8_t **begun);
void hw_end_block(hw_writer *w, uint8_t *begun);
bool hw_put_report(hw_writer *w, const hw_report *report);
bool hw_put_container(hw_writer *w, uint8_t type, uint8_t count);
bool hw_put_pair(hw_writer *w, const hw_pair *pair);
bool hw_put_id(hw_writer *w, uint8_t id);
bool hw_put_update(hw_writer *w, const hw_update *u);
bool hw_put_create(hw_writer *w, const hw_create *c);
bool hw_put_octets(hw_writer *w, const uint8_t *octets, size_t size);
#endif
