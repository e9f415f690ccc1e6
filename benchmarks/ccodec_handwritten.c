#include "ccodec_handwritten.h"
#include <string.h>

static uint16_t get16(const uint8_t *p) { return (uint16_t)(p[0] << 8 | p[1]); }
static uint32_t get32(const uint8_t *p)
{
    return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3];
}
/* The implementation is for little-endian processors, and so is this. */
static int64_t get64le(const uint8_t *p) { int64_t v; memcpy(&v, p, 8); return v; }
static double getd(const uint8_t *p) { double v; memcpy(&v, p, 8); return v; }
static uint32_t get32le(const uint8_t *p) { uint32_t v; memcpy(&v, p, 4); return v; }
static void put16(uint8_t *p, uint16_t v) { p[0] = (uint8_t)(v >> 8); p[1] = (uint8_t)v; }
static void put32(uint8_t *p, uint32_t v) { put16(p, (uint16_t)(v >> 16)); put16(p + 2, (uint16_t)v); }

static bool get_header(const uint8_t *p, size_t size, hw_header *h)
{
    if (size < 18 || p[0] != 1 || get16(p + 1) != 0x497E)
        return false;
    memcpy(h->sender, p + 3, 6);
    h->network = get16(p + 9);
    h->length = get16(p + 11);
    h->count = p[13];
    h->seqno = get32(p + 14);
    return h->length != 0 && h->count != 0 && h->length <= size - 18;
}

static bool get_report(const uint8_t *p, size_t size, hw_report *r)
{
    if (size != 64)
        return false;
    r->x = getd(p);
    r->y = getd(p + 8);
    r->z = getd(p + 16);
    memcpy(r->node, p + 32, 6);
    r->stamp = get64le(p + 48);
    r->seqno = get32le(p + 56);
    return true;
}

static const uint8_t *get_create(const uint8_t *p, const uint8_t *end, hw_create *c)
{
    if (end - p < 19)
        return NULL;
    c->id = p[0];
    memcpy(c->producer, p + 1, 6);
    c->repetitions = p[7];
    c->created = get64le(p + 8);
    c->timeout = get16(p + 16);
    c->descr_size = p[18];
    p += 19;
    if (end - p < c->descr_size + 3)
        return NULL;
    c->descr = p;
    p += c->descr_size;
    c->upd_id = p[0];
    c->seqno = p[1];
    c->size = p[2];
    p += 3;
    if (end - p < c->size)
        return NULL;
    c->value = p;
    return p + c->size;
}

static const uint8_t *get_update(const uint8_t *p, const uint8_t *end, hw_update *u)
{
    if (end - p < 3)
        return NULL;
    u->id = p[0];
    u->seqno = p[1];
    u->size = p[2];
    p += 3;
    if (end - p < u->size)
        return NULL;
    u->value = p;
    return p + u->size;
}

static bool get_containers(const uint8_t *p, const uint8_t *end, hw_sink *sink)
{
    while (p != end) {
        unsigned type, count, i;
        if (end - p < 2)
            return false;
        type = p[0];
        count = p[1];
        p += 2;
        if (count == 0)
            return false;
        for (i = 0; i < count; i++) {
            hw_create c;
            hw_update u;
            switch (type) {
            case 1:
            case 3:
                if (end - p < 2)
                    return false;
                sink->sum += p[0] + p[1];
                p += 2;
                break;
            case 2:
                p = get_update(p, end, &u);
                if (p == NULL)
                    return false;
                sink->sum += u.id + u.seqno + u.size + (u.size != 0 ? u.value[0] : 0);
                break;
            case 4:
            case 6:
                if (p == end)
                    return false;
                sink->sum += *p++;
                break;
            case 5:
                p = get_create(p, end, &c);
                if (p == NULL)
                    return false;
                sink->sum += c.id + c.producer[5] + c.repetitions + (uint64_t)c.created + c.timeout + c.descr_size
                           + c.upd_id + c.seqno + c.size + (c.size != 0 ? c.value[0] : 0);
                break;
            default:
                return false;
            }
        }
    }
    return true;
}

bool hw_decode(const uint8_t *p, size_t size, hw_sink *sink)
{
    const uint8_t *end;
    unsigned count = 0;
    hw_header h;
    if (!get_header(p, size, &h))
        return false;
    sink->sum += h.sender[5] + h.network + h.seqno;
    end = p + 18 + h.length;
    p += 18;
    while (p != end) {
        unsigned protocol, length;
        if (end - p < 4)
            return false;
        protocol = get16(p);
        length = get16(p + 2);
        p += 4;
        if ((size_t)(end - p) < length)
            return false;
        if (protocol == 2) {
            if (!get_containers(p, p + length, sink))
                return false;
        } else if (protocol == 1) {
            hw_report r;
            if (!get_report(p, length, &r))
                return false;
            sink->sum += (uint64_t)r.stamp + r.seqno + r.node[5] + (r.x > r.y) + (r.z > 0);
        } else {
            sink->sum += length;
        }
        p += length;
        count++;
    }
    return count == h.count;
}

/* Decode a valid beacon and encode it again: what is read is written at once, every length checked. */
size_t hw_encode(const uint8_t *p, size_t size, uint8_t *to, size_t room)
{
    const uint8_t *end;
    uint8_t *w = to, *const limit = to + room;
    unsigned blocks = 0;
    hw_header h;
    if (!get_header(p, size, &h) || room < 18)
        return 0;
    end = p + 18 + h.length;
    p += 18;
    w += 18;
    while (p != end) {
        uint8_t *const block = w;
        const unsigned protocol = get16(p), length = get16(p + 2);
        const uint8_t *const stop = p + 4 + length;
        p += 4;
        if (limit - w < 4)
            return 0;
        w += 4;
        if (protocol == 2) {
            while (p != stop) {
                const unsigned type = p[0], count = p[1];
                uint8_t *const container = w;
                unsigned i, written = 0;
                p += 2;
                if (limit - w < 2)
                    return 0;
                w += 2;
                for (i = 0; i < count; i++, written++) {
                    if (type == 1 || type == 3) {
                        if (limit - w < 2)
                            return 0;
                        w[0] = p[0];
                        w[1] = p[1];
                        p += 2;
                        w += 2;
                    } else if (type == 4 || type == 6) {
                        if (limit == w)
                            return 0;
                        *w++ = *p++;
                    } else if (type == 2) {
                        hw_update u;
                        p = get_update(p, stop, &u);
                        if (p == NULL || limit - w < 3 + u.size)
                            return 0;
                        w[0] = u.id;
                        w[1] = u.seqno;
                        w[2] = u.size;
                        memcpy(w + 3, u.value, u.size);
                        w += 3 + u.size;
                    } else {
                        hw_create c;
                        p = get_create(p, stop, &c);
                        if (p == NULL || limit - w < 22 + c.descr_size + c.size)
                            return 0;
                        w[0] = c.id;
                        memcpy(w + 1, c.producer, 6);
                        w[7] = c.repetitions;
                        memcpy(w + 8, &c.created, 8);
                        put16(w + 16, c.timeout);
                        w[18] = c.descr_size;
                        memcpy(w + 19, c.descr, c.descr_size);
                        w += 19 + c.descr_size;
                        w[0] = c.upd_id;
                        w[1] = c.seqno;
                        w[2] = c.size;
                        memcpy(w + 3, c.value, c.size);
                        w += 3 + c.size;
                    }
                }
                container[0] = (uint8_t)type;
                container[1] = (uint8_t)written;
            }
        } else if (protocol == 1) {
            hw_report r;
            if (!get_report(p, length, &r) || limit - w < 64)
                return 0;
            memcpy(w, &r.x, 8);
            memcpy(w + 8, &r.y, 8);
            memcpy(w + 16, &r.z, 8);
            memcpy(w + 24, p + 24, 8);
            memcpy(w + 32, r.node, 6);
            memcpy(w + 38, p + 38, 10);
            memcpy(w + 48, &r.stamp, 8);
            memcpy(w + 56, &r.seqno, 4);
            memcpy(w + 60, p + 60, 4);
            w += 64;
        } else {
            if ((size_t)(limit - w) < length)
                return 0;
            memcpy(w, p, length);
            w += length;
        }
        put16(block, (uint16_t)protocol);
        put16(block + 2, (uint16_t)(w - block - 4));
        p = stop;
        blocks++;
    }
    to[0] = 1;
    put16(to + 1, 0x497E);
    memcpy(to + 3, h.sender, 6);
    put16(to + 9, h.network);
    put16(to + 11, (uint16_t)(w - to - 18));
    to[13] = (uint8_t)blocks;
    put32(to + 14, h.seqno);
    return (size_t)(w - to);
}
