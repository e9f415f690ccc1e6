/* The node of examples/c-node for vector.c. */
#include "upper_tester.h"
#include "vector.h"

#include <string.h>

#define MS 1000000

static node_t node;
static node_time_t current;
static int64_t started; /* wall clock at the start, ns since 1970 */
static char answer[200000];

static void note(const char *kind, unsigned number, const uint8_t *octets, size_t size)
{
    vector_note((double)current.now / MS, kind, number, octets, size);
}

#define NEXT(name, type)                                                                                                \
    {                                                                                                                  \
        type record;                                                                                                   \
        while (at = container.records.at, dcp_next_##name(&container.records, &record))                                \
            note("record", container.ic_type, content + at, container.records.at - at);                                \
        break;                                                                                                         \
    }

static void sent_containers(const uint8_t *content, size_t size)
{
    dcp_list_t list = dcp_containers(content, size);
    dcp_container_t container;
    dcp_problem_t problem;
    size_t at;
    while (dcp_next_container(&list, &container, &problem))
        switch (container.ic_type) {
        case DCP_IC_SUMMARIES:
            NEXT(var_summ, dcp_var_summ_t)
        case DCP_IC_UPDATES:
            NEXT(var_update, dcp_var_update_t)
        case DCP_IC_REQUEST_VARUPDATES:
            NEXT(var_req_update, dcp_var_req_update_t)
        case DCP_IC_REQUEST_VARCREATES:
            NEXT(var_req_create, dcp_var_req_create_t)
        case DCP_IC_CREATE_VARIABLES:
            NEXT(var_create, dcp_var_create_t)
        default:
            NEXT(var_delete, dcp_var_delete_t)
        }
    if (problem.reason != DCP_OK)
        vector_failed("containers", "good ones", dcp_reason_name(problem.reason));
}

static void sent(void *user, const uint8_t *octets, size_t size)
{
    dcp_beacon_t beacon;
    dcp_payload_t payload;
    dcp_problem_t problem;
    (void)user;
    if (!dcp_read_beacon(octets, size, &beacon, &problem)) {
        vector_failed("beacon", "a good one", dcp_reason_name(problem.reason));
        return;
    }
    note("beacon", 0, octets, DCP_BP_HEADER_SIZE);
    while (dcp_next_payload(&beacon.payloads, &payload, &problem)) {
        if (payload.protocol_id == DCP_PROTOCOL_VARDIS)
            sent_containers(payload.content.data, payload.content.size);
        else
            note("payload", payload.protocol_id, payload.content.data, payload.content.size);
    }
}

static void received(void *user, uint16_t protocol_id, const uint8_t *payload, size_t size, const uint8_t *sender_id)
{
    (void)user;
    (void)sender_id;
    if (protocol_id != DCP_PROTOCOL_SRP && protocol_id != DCP_PROTOCOL_VARDIS)
        note("indication", protocol_id, payload, size);
}

static void transmitted(void *user, uint16_t protocol_id, int64_t next_beacon)
{
    (void)user;
    (void)next_beacon;
    if (protocol_id != DCP_PROTOCOL_SRP && protocol_id != DCP_PROTOCOL_VARDIS)
        note("transmitted", protocol_id, NULL, 0);
}

static void changed(void *user, variable_event_t event, const variable_t *variable)
{
    (void)user;
    (void)event;
    (void)variable;
}

static void seen(void *user, const uint8_t *node_id, bool is_new)
{
    (void)user;
    (void)node_id;
    (void)is_new;
}

static void expired(void *user, const uint8_t *node_id)
{
    (void)user;
    (void)node_id;
}

static const node_events_t callbacks = {sent, received, transmitted, changed, seen, expired};

static node_time_t now(void)
{
    return current;
}

static void registered(int number, uint16_t protocol_id)
{
    (void)number;
    (void)protocol_id;
}

void sut_advance(int64_t ms)
{
    while (node_due(&node) <= ms * MS) {
        if (node_due(&node) > current.now)
            current.now = node_due(&node);
        current.wall = started + current.now;
        node_poll(&node, current);
    }
    current.now = ms * MS;
    current.wall = started + current.now;
}

void sut_start(const uint8_t *node_id, int64_t wall_clock)
{
    static bool before;
    current.now = 0;
    current.wall = started = wall_clock;
    if (before) /* frees what waits */
        node_reset(&node, current);
    before = true;
    node_init(&node, node_id, &callbacks, NULL, current);
}

void sut_receive(const uint8_t *octets, size_t size)
{
    node_receive(&node, octets, size, current);
}

static void flush(dcp_out_t *out)
{
    const size_t before = strlen(answer);
    if (before + out->at < sizeof answer) {
        memcpy(answer + before, out->data, out->at);
        answer[before + out->at] = '\0';
    }
    out->at = 0;
}

const char *sut_call(char *request)
{
    static char data[65536];
    static session_t session;
    dcp_out_t out;
    memset(&out, 0, sizeof out);
    session.clock = now;
    session.registered = registered;
    out.data = data;
    out.size = sizeof data;
    out.flush = flush;
    out.user = &session;
    answer[0] = '\0';
    dcp_handle_line(&methods, &node, request, strlen(request), &out);
    return answer;
}
