#include "ccodec_handwritten.h"
#include <string.h>

static uint16_t get16(const uint8_t *p) { return (uint16_t)(p[0] << 8 | p[1]); }
static uint32_t get32(const uint8_t *p)
{
    return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3];
}
static void put16(uint8_t *p, uint16_t v) { p[0] = (uint8_t)(v >> 8); p[1] = (uint8_t)v; }
static void put32(uint8_t *p, uint32_t v) { put16(p, (uint16_t)(v >> 16)); put16(p + 2, (uint16_t)v); }

#ifndef BY_FIELD

bool hw_get_header(hw_reader *r, hw_header *h)
{
    const uint8_t *const p = r->p;
    if (r->end - p < 18 || p[0] != 1 || get16(p + 1) != 0x497E)
        return false;
    memcpy(h->sender, p + 3, 6);
    h->network = get16(p + 9);
    h->length = get16(p + 11);
    h->count = p[13];
    h->seqno = get32(p + 14);
    if (h->length == 0 || h->count == 0 || h->length > r->end - p - 18)
        return false;
    r->p += 18;
    r->end = r->p + h->length;
    return true;
}

bool hw_get_block(hw_reader *r, hw_block *b)
{
    if (r->end - r->p < 4)
        return false;
    b->protocol = get16(r->p);
    b->length = get16(r->p + 2);
    b->content = r->p + 4;
    if (r->end - b->content < b->length)
        return false;
    r->p = b->content + b->length;
    return true;
}

bool hw_get_report(const hw_block *b, hw_report *report)
{
    const uint8_t *const p = b->content;
    if (b->length != 64)
        return false;
    memcpy(&report->x, p, 8);
    memcpy(&report->y, p + 8, 8);
    memcpy(&report->z, p + 16, 8);
    memcpy(report->gaps, p + 24, 8);
    memcpy(report->node, p + 32, 6);
    memcpy(report->gaps + 8, p + 38, 10);
    memcpy(&report->stamp, p + 48, 8);
    memcpy(&report->seqno, p + 56, 4);
    memcpy(report->gaps + 18, p + 60, 4);
    return true;
}

bool hw_get_container(hw_reader *r, uint8_t *type, uint8_t *count)
{
    if (r->end - r->p < 2 || r->p[1] == 0 || r->p[0] < 1 || r->p[0] > 6)
        return false;
    *type = r->p[0];
    *count = r->p[1];
    r->p += 2;
    return true;
}

bool hw_get_pair(hw_reader *r, hw_pair *pair)
{
    if (r->end - r->p < 2)
        return false;
    pair->id = r->p[0];
    pair->seqno = r->p[1];
    r->p += 2;
    return true;
}

bool hw_get_id(hw_reader *r, uint8_t *id)
{
    if (r->p == r->end)
        return false;
    *id = *r->p++;
    return true;
}

bool hw_get_update(hw_reader *r, hw_update *u)
{
    const uint8_t *p = r->p;
    if (r->end - p < 3)
        return false;
    u->id = p[0];
    u->seqno = p[1];
    u->size = p[2];
    p += 3;
    if (r->end - p < u->size)
        return false;
    u->value = p;
    r->p = p + u->size;
    return true;
}

bool hw_get_create(hw_reader *r, hw_create *c)
{
    const uint8_t *p = r->p;
    if (r->end - p < 19)
        return false;
    c->id = p[0];
    memcpy(c->producer, p + 1, 6);
    c->repetitions = p[7];
    memcpy(&c->created, p + 8, 8);
    c->timeout = get16(p + 16);
    c->descr_size = p[18];
    p += 19;
    if (r->end - p < c->descr_size + 3)
        return false;
    c->descr = p;
    p += c->descr_size;
    c->upd_id = p[0];
    c->seqno = p[1];
    c->size = p[2];
    p += 3;
    if (r->end - p < c->size)
        return false;
    c->value = p;
    r->p = p + c->size;
    return true;
}

bool hw_put_header(hw_writer *w, const hw_header *h)
{
    uint8_t *const p = w->p;
    if (w->end - p < 18)
        return false;
    p[0] = 1;
    put16(p + 1, 0x497E);
    memcpy(p + 3, h->sender, 6);
    put16(p + 9, h->network);
    put16(p + 11, h->length);
    p[13] = h->count;
    put32(p + 14, h->seqno);
    w->p += 18;
    return true;
}

bool hw_put_block(hw_writer *w, uint16_t protocol, uint8_t **begun)
{
    if (w->end - w->p < 4)
        return false;
    *begun = w->p;
    put16(w->p, protocol);
    w->p += 4;
    return true;
}

void hw_end_block(hw_writer *w, uint8_t *begun)
{
    put16(begun + 2, (uint16_t)(w->p - begun - 4));
}

bool hw_put_report(hw_writer *w, const hw_report *report)
{
    uint8_t *const p = w->p;
    if (w->end - p < 64)
        return false;
    memcpy(p, &report->x, 8);
    memcpy(p + 8, &report->y, 8);
    memcpy(p + 16, &report->z, 8);
    memcpy(p + 24, report->gaps, 8);
    memcpy(p + 32, report->node, 6);
    memcpy(p + 38, report->gaps + 8, 10);
    memcpy(p + 48, &report->stamp, 8);
    memcpy(p + 56, &report->seqno, 4);
    memcpy(p + 60, report->gaps + 18, 4);
    w->p += 64;
    return true;
}

bool hw_put_container(hw_writer *w, uint8_t type, uint8_t count)
{
    if (w->end - w->p < 2 || count == 0)
        return false;
    w->p[0] = type;
    w->p[1] = count;
    w->p += 2;
    return true;
}

bool hw_put_pair(hw_writer *w, const hw_pair *pair)
{
    if (w->end - w->p < 2)
        return false;
    w->p[0] = pair->id;
    w->p[1] = pair->seqno;
    w->p += 2;
    return true;
}

bool hw_put_id(hw_writer *w, uint8_t id)
{
    if (w->p == w->end)
        return false;
    *w->p++ = id;
    return true;
}

bool hw_put_update(hw_writer *w, const hw_update *u)
{
    uint8_t *const p = w->p;
    if (w->end - p < 3 + u->size)
        return false;
    p[0] = u->id;
    p[1] = u->seqno;
    p[2] = u->size;
    memcpy(p + 3, u->value, u->size);
    w->p += 3 + u->size;
    return true;
}

bool hw_put_create(hw_writer *w, const hw_create *c)
{
    uint8_t *p = w->p;
    if (w->end - p < 22 + c->descr_size + c->size)
        return false;
    p[0] = c->id;
    memcpy(p + 1, c->producer, 6);
    p[7] = c->repetitions;
    memcpy(p + 8, &c->created, 8);
    put16(p + 16, c->timeout);
    p[18] = c->descr_size;
    memcpy(p + 19, c->descr, c->descr_size);
    p += 19 + c->descr_size;
    p[0] = c->upd_id;
    p[1] = c->seqno;
    p[2] = c->size;
    memcpy(p + 3, c->value, c->size);
    w->p = p + 3 + c->size;
    return true;
}

bool hw_put_octets(hw_writer *w, const uint8_t *octets, size_t size)
{
    if ((size_t)(w->end - w->p) < size)
        return false;
    memcpy(w->p, octets, size);
    w->p += size;
    return true;
}

#else

static bool get_octets(hw_reader *r, void *to, size_t size)
{
    if ((size_t)(r->end - r->p) < size)
        return false;
    memcpy(to, r->p, size);
    r->p += size;
    return true;
}

static bool get_u8(hw_reader *r, uint8_t *v) { return get_octets(r, v, 1); }

static bool get_u16(hw_reader *r, uint16_t *v)
{
    uint8_t octets[2];
    if (!get_octets(r, octets, 2))
        return false;
    *v = get16(octets);
    return true;
}

static bool get_u32(hw_reader *r, uint32_t *v)
{
    uint8_t octets[4];
    if (!get_octets(r, octets, 4))
        return false;
    *v = get32(octets);
    return true;
}

static bool get_view(hw_reader *r, const uint8_t **view, size_t size)
{
    if ((size_t)(r->end - r->p) < size)
        return false;
    *view = r->p;
    r->p += size;
    return true;
}

bool hw_get_header(hw_reader *r, hw_header *h)
{
    uint8_t version;
    uint16_t magic;
    if (!get_u8(r, &version) || version != 1 || !get_u16(r, &magic) || magic != 0x497E || !get_octets(r, h->sender, 6)
        || !get_u16(r, &h->network) || !get_u16(r, &h->length) || h->length == 0 || !get_u8(r, &h->count)
        || h->count == 0 || !get_u32(r, &h->seqno) || h->length > r->end - r->p)
        return false;
    r->end = r->p + h->length;
    return true;
}

bool hw_get_block(hw_reader *r, hw_block *b)
{
    return get_u16(r, &b->protocol) && get_u16(r, &b->length) && get_view(r, &b->content, b->length);
}

bool hw_get_report(const hw_block *b, hw_report *report)
{
    hw_reader r = {b->content, b->content + b->length};
    return get_octets(&r, &report->x, 8) && get_octets(&r, &report->y, 8) && get_octets(&r, &report->z, 8)
        && get_octets(&r, report->gaps, 8) && get_octets(&r, report->node, 6) && get_octets(&r, report->gaps + 8, 10)
        && get_octets(&r, &report->stamp, 8) && get_octets(&r, &report->seqno, 4)
        && get_octets(&r, report->gaps + 18, 4) && r.p == r.end;
}

bool hw_get_container(hw_reader *r, uint8_t *type, uint8_t *count)
{
    return get_u8(r, type) && *type >= 1 && *type <= 6 && get_u8(r, count) && *count != 0;
}

bool hw_get_pair(hw_reader *r, hw_pair *pair) { return get_u8(r, &pair->id) && get_u8(r, &pair->seqno); }

bool hw_get_id(hw_reader *r, uint8_t *id) { return get_u8(r, id); }

bool hw_get_update(hw_reader *r, hw_update *u)
{
    return get_u8(r, &u->id) && get_u8(r, &u->seqno) && get_u8(r, &u->size) && get_view(r, &u->value, u->size);
}

bool hw_get_create(hw_reader *r, hw_create *c)
{
    return get_u8(r, &c->id) && get_octets(r, c->producer, 6) && get_u8(r, &c->repetitions)
        && get_octets(r, &c->created, 8) && get_u16(r, &c->timeout) && get_u8(r, &c->descr_size)
        && get_view(r, &c->descr, c->descr_size) && get_u8(r, &c->upd_id) && get_u8(r, &c->seqno)
        && get_u8(r, &c->size) && get_view(r, &c->value, c->size);
}

bool hw_put_octets(hw_writer *w, const uint8_t *octets, size_t size)
{
    if ((size_t)(w->end - w->p) < size)
        return false;
    memcpy(w->p, octets, size);
    w->p += size;
    return true;
}

static bool put_any(hw_writer *w, const void *octets, size_t size) { return hw_put_octets(w, octets, size); }

static bool put_u8(hw_writer *w, uint8_t v) { return put_any(w, &v, 1); }

static bool put_u16(hw_writer *w, uint16_t v)
{
    uint8_t octets[2];
    put16(octets, v);
    return put_any(w, octets, 2);
}

static bool put_u32(hw_writer *w, uint32_t v)
{
    uint8_t octets[4];
    put32(octets, v);
    return put_any(w, octets, 4);
}

bool hw_put_header(hw_writer *w, const hw_header *h)
{
    return put_u8(w, 1) && put_u16(w, 0x497E) && put_any(w, h->sender, 6) && put_u16(w, h->network)
        && put_u16(w, h->length) && put_u8(w, h->count) && put_u32(w, h->seqno);
}

bool hw_put_block(hw_writer *w, uint16_t protocol, uint8_t **begun)
{
    *begun = w->p;
    return put_u16(w, protocol) && put_u16(w, 0);
}

void hw_end_block(hw_writer *w, uint8_t *begun) { put16(begun + 2, (uint16_t)(w->p - begun - 4)); }

bool hw_put_report(hw_writer *w, const hw_report *report)
{
    return put_any(w, &report->x, 8) && put_any(w, &report->y, 8) && put_any(w, &report->z, 8)
        && put_any(w, report->gaps, 8) && put_any(w, report->node, 6) && put_any(w, report->gaps + 8, 10)
        && put_any(w, &report->stamp, 8) && put_any(w, &report->seqno, 4) && put_any(w, report->gaps + 18, 4);
}

bool hw_put_container(hw_writer *w, uint8_t type, uint8_t count)
{
    return count != 0 && put_u8(w, type) && put_u8(w, count);
}

bool hw_put_pair(hw_writer *w, const hw_pair *pair) { return put_u8(w, pair->id) && put_u8(w, pair->seqno); }

bool hw_put_id(hw_writer *w, uint8_t id) { return put_u8(w, id); }

bool hw_put_update(hw_writer *w, const hw_update *u)
{
    return put_u8(w, u->id) && put_u8(w, u->seqno) && put_u8(w, u->size) && put_any(w, u->value, u->size);
}

bool hw_put_create(hw_writer *w, const hw_create *c)
{
    return put_u8(w, c->id) && put_any(w, c->producer, 6) && put_u8(w, c->repetitions) && put_any(w, &c->created, 8)
        && put_u16(w, c->timeout) && put_u8(w, c->descr_size) && put_any(w, c->descr, c->descr_size)
        && put_u8(w, c->upd_id) && put_u8(w, c->seqno) && put_u8(w, c->size) && put_any(w, c->value, c->size);
}

#endif
