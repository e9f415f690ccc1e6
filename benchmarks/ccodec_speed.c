/* Measures the generated codec and the hand-written one on beacons from standard input, in turns. */
#define _GNU_SOURCE
#include "ccodec_handwritten.h"
#include "dcp_codec.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define SUM_OCTET(octets) ((octets).size != 0 ? (octets).data[0] : 0u)

/* What is done with the contents: the same for both codecs. */
typedef struct {
    uint64_t sum;
} hw_sink;

static bool hw_decode(const uint8_t *octets, size_t size, hw_sink *sink)
{
    hw_reader r = {octets, octets + size};
    unsigned count = 0;
    hw_header h;
    if (!hw_get_header(&r, &h))
        return false;
    sink->sum += h.sender[5] + (uint64_t)h.network + h.seqno;
    for (; r.p != r.end; count++) {
        hw_block b;
        if (!hw_get_block(&r, &b))
            return false;
        if (b.protocol == 2) {
            hw_reader c = {b.content, b.content + b.length};
            while (c.p != c.end) {
                uint8_t type, left, id;
                hw_pair pair;
                hw_update u;
                hw_create create;
                if (!hw_get_container(&c, &type, &left))
                    return false;
                for (; left != 0; left--) {
                    switch (type) {
                    case 1:
                    case 3:
                        if (!hw_get_pair(&c, &pair))
                            return false;
                        sink->sum += (uint64_t)pair.id + pair.seqno;
                        break;
                    case 2:
                        if (!hw_get_update(&c, &u))
                            return false;
                        sink->sum += (uint64_t)u.id + u.seqno + u.size + (u.size != 0 ? u.value[0] : 0u);
                        break;
                    case 4:
                    case 6:
                        if (!hw_get_id(&c, &id))
                            return false;
                        sink->sum += id;
                        break;
                    default:
                        if (!hw_get_create(&c, &create))
                            return false;
                        sink->sum += create.id + create.producer[5] + create.repetitions + (uint64_t)create.created
                                   + create.timeout + create.descr_size + create.upd_id + create.seqno + create.size
                                   + (create.size != 0 ? create.value[0] : 0u);
                        break;
                    }
                }
            }
        } else if (b.protocol == 1) {
            hw_report report;
            if (!hw_get_report(&b, &report))
                return false;
            sink->sum += (uint64_t)report.stamp + report.seqno + report.node[5] + (report.x > report.y) + (report.z > 0);
        } else {
            sink->sum += b.length;
        }
    }
    return count == h.count;
}

/* Read a beacon and write it again. */
static size_t hw_encode(const uint8_t *octets, size_t size, uint8_t *to, size_t room)
{
    hw_reader r = {octets, octets + size};
    hw_writer w = {to, to + room};
    hw_header h;
    if (!hw_get_header(&r, &h) || !hw_put_header(&w, &h))
        return 0;
    while (r.p != r.end) {
        uint8_t *begun;
        hw_block b;
        if (!hw_get_block(&r, &b) || !hw_put_block(&w, b.protocol, &begun))
            return 0;
        if (b.protocol == 2) {
            hw_reader c = {b.content, b.content + b.length};
            while (c.p != c.end) {
                uint8_t type, left, id;
                hw_pair pair;
                hw_update u;
                hw_create create;
                bool good = hw_get_container(&c, &type, &left) && hw_put_container(&w, type, left);
                for (; good && left != 0; left--) {
                    switch (type) {
                    case 1:
                    case 3:
                        good = hw_get_pair(&c, &pair) && hw_put_pair(&w, &pair);
                        break;
                    case 2:
                        good = hw_get_update(&c, &u) && hw_put_update(&w, &u);
                        break;
                    case 4:
                    case 6:
                        good = hw_get_id(&c, &id) && hw_put_id(&w, id);
                        break;
                    default:
                        good = hw_get_create(&c, &create) && hw_put_create(&w, &create);
                        break;
                    }
                }
                if (!good)
                    return 0;
            }
        } else if (b.protocol == 1) {
            hw_report report;
            if (!hw_get_report(&b, &report) || !hw_put_report(&w, &report))
                return 0;
        } else if (!hw_put_octets(&w, b.content, b.length)) {
            return 0;
        }
        hw_end_block(&w, begun);
    }
    return (size_t)(w.p - to);
}

static bool decode(const uint8_t *octets, size_t size, hw_sink *sink)
{
    dcp_beacon_t beacon;
    dcp_payload_t payload;
    dcp_problem_t problem;
    dcp_container_t container;
    if (!dcp_read_beacon(octets, size, &beacon, &problem))
        return false;
    sink->sum += beacon.bp.sender_id[5] + (uint64_t)beacon.bp.network_id + beacon.bp.seqno;
    while (dcp_next_payload(&beacon.payloads, &payload, &problem)) {
        if (payload.protocol_id == DCP_PROTOCOL_VARDIS) {
            dcp_list_t list = dcp_containers(payload.content.data, payload.content.size);
            while (dcp_next_container(&list, &container, &problem)) {
                dcp_list_t *const records = &container.records;
                dcp_var_summ_t summ;
                dcp_var_update_t update;
                dcp_var_req_update_t req_update;
                dcp_var_req_create_t req_create;
                dcp_var_create_t c;
                dcp_var_delete_t deletion;
                switch (container.ic_type) {
                case DCP_IC_SUMMARIES:
                    while (dcp_next_var_summ(records, &summ))
                        sink->sum += (uint64_t)summ.var_id + summ.seqno;
                    break;
                case DCP_IC_UPDATES:
                    while (dcp_next_var_update(records, &update))
                        sink->sum += update.var_id + update.seqno + update.value.size + SUM_OCTET(update.value);
                    break;
                case DCP_IC_REQUEST_VARUPDATES:
                    while (dcp_next_var_req_update(records, &req_update))
                        sink->sum += (uint64_t)req_update.var_id + req_update.seqno;
                    break;
                case DCP_IC_REQUEST_VARCREATES:
                    while (dcp_next_var_req_create(records, &req_create))
                        sink->sum += req_create.var_id;
                    break;
                case DCP_IC_CREATE_VARIABLES:
                    while (dcp_next_var_create(records, &c))
                        sink->sum += c.spec.var_id + c.spec.prod_id[5] + c.spec.rep_cnt
                                   + (uint64_t)c.spec.creation_time + c.spec.timeout + c.spec.descr.size
                                   + c.upd.var_id + c.upd.seqno + c.upd.value.size + SUM_OCTET(c.upd.value);
                    break;
                default:
                    while (dcp_next_var_delete(records, &deletion))
                        sink->sum += deletion.var_id;
                    break;
                }
            }
        } else if (payload.protocol_id == DCP_PROTOCOL_SRP) {
            dcp_extended_safety_data_t r;
            if (!dcp_read_extended_safety_data(payload.content.data, payload.content.size, &r, &problem))
                return false;
            sink->sum += (uint64_t)r.t_stamp + r.seqno + r.node_id[5] + (r.s_data.x > r.s_data.y) + (r.s_data.z > 0);
        } else {
            sink->sum += payload.content.size;
        }
        if (problem.reason != DCP_OK)
            return false;
    }
    return problem.reason == DCP_OK;
}

static size_t encode(const uint8_t *octets, size_t size, uint8_t *to, size_t room)
{
    dcp_beacon_t beacon;
    dcp_payload_t payload;
    dcp_problem_t problem;
    dcp_container_t container;
    dcp_writer_t w;
    dcp_write_to(&w, to, room);
    if (!dcp_read_beacon(octets, size, &beacon, &problem) || !dcp_begin_beacon(&w, &beacon.bp))
        return 0;
    while (dcp_next_payload(&beacon.payloads, &payload, &problem)) {
        if (!dcp_begin_payload(&w, &payload))
            return 0;
        if (payload.protocol_id == DCP_PROTOCOL_VARDIS) {
            dcp_list_t list = dcp_containers(payload.content.data, payload.content.size);
            while (dcp_next_container(&list, &container, &problem)) {
                dcp_list_t *const records = &container.records;
                bool good = dcp_begin_container(&w, &container);
                dcp_var_summ_t summ;
                dcp_var_update_t update;
                dcp_var_req_update_t req_update;
                dcp_var_req_create_t req_create;
                dcp_var_create_t create;
                dcp_var_delete_t deletion;
                switch (container.ic_type) {
                case DCP_IC_SUMMARIES:
                    while (good && dcp_next_var_summ(records, &summ))
                        good = dcp_add_var_summ(&w, &summ);
                    break;
                case DCP_IC_UPDATES:
                    while (good && dcp_next_var_update(records, &update))
                        good = dcp_add_var_update(&w, &update);
                    break;
                case DCP_IC_REQUEST_VARUPDATES:
                    while (good && dcp_next_var_req_update(records, &req_update))
                        good = dcp_add_var_req_update(&w, &req_update);
                    break;
                case DCP_IC_REQUEST_VARCREATES:
                    while (good && dcp_next_var_req_create(records, &req_create))
                        good = dcp_add_var_req_create(&w, &req_create);
                    break;
                case DCP_IC_CREATE_VARIABLES:
                    while (good && dcp_next_var_create(records, &create))
                        good = dcp_add_var_create(&w, &create);
                    break;
                default:
                    while (good && dcp_next_var_delete(records, &deletion))
                        good = dcp_add_var_delete(&w, &deletion);
                    break;
                }
                if (!good || !dcp_end_container(&w))
                    return 0;
            }
        } else if (payload.protocol_id == DCP_PROTOCOL_SRP) {
            dcp_extended_safety_data_t report;
            if (!dcp_read_extended_safety_data(payload.content.data, payload.content.size, &report, &problem)
                || !dcp_add_extended_safety_data(&w, &report))
                return 0;
        } else if (!dcp_add_octets(&w, payload.content.data, payload.content.size)) {
            return 0;
        }
        if (!dcp_end_payload(&w, &payload))
            return 0;
    }
    return dcp_end_beacon(&w) ? w.at : 0;
}

typedef struct {
    uint8_t *octets;
    size_t size;
} beacon_octets;

static double seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + (double)t.tv_nsec / 1e9;
}

int main(int argc, char **argv)
{
    static const char *const names[] = {"decode generated", "decode handwritten", "encode generated",
                                        "encode handwritten"};
    const double limit = argc > 1 ? atof(argv[1]) : 1.0;
    static uint8_t out[65536];
    double best[4] = {1e9, 1e9, 1e9, 1e9}, spent = 0;
    beacon_octets *all = NULL;
    uint64_t sums[2] = {0, 0};
    size_t count = 0, i;
    uint32_t size;
    int who;
    while (fread(&size, 1, 4, stdin) == 4) {
        all = realloc(all, (count + 1) * sizeof *all);
        all[count].octets = malloc(size);
        all[count].size = size;
        if (fread(all[count++].octets, 1, size, stdin) != size)
            return 1;
    }
    for (i = 0; i < count; i++) {
        hw_sink one = {0}, other = {0};
        if (!decode(all[i].octets, all[i].size, &one) || !hw_decode(all[i].octets, all[i].size, &other)
            || one.sum != other.sum || encode(all[i].octets, all[i].size, out, sizeof out) != all[i].size
            || memcmp(out, all[i].octets, all[i].size) != 0
            || hw_encode(all[i].octets, all[i].size, out, sizeof out) != all[i].size
            || memcmp(out, all[i].octets, all[i].size) != 0) {
            fprintf(stderr, "beacon %zu: the two codecs disagree\n", i);
            return 1;
        }
    }
    while (spent < 4 * limit) {
        for (who = 0; who < 4; who++) {
            const double begun = seconds();
            hw_sink sink = {0};
            double took;
            size_t written = 0;
            for (i = 0; i < count; i++) {
                if (who == 0)
                    (void)decode(all[i].octets, all[i].size, &sink);
                else if (who == 1)
                    (void)hw_decode(all[i].octets, all[i].size, &sink);
                else if (who == 2)
                    written += encode(all[i].octets, all[i].size, out, sizeof out);
                else
                    written += hw_encode(all[i].octets, all[i].size, out, sizeof out);
            }
            took = seconds() - begun;
            spent += took;
            sums[who / 2] += sink.sum + written;
            if (took < best[who])
                best[who] = took;
        }
    }
    printf("{");
    for (who = 0; who < 4; who++)
        printf("\"%s\": %.2f, ", names[who], best[who] / (double)count * 1e9);
    printf("\"beacons\": %zu}\n", count);
    return (int)(sums[0] + sums[1] == 0);
}
