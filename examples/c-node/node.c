/* BP, SRP and VarDis of the specification 2.0. The identifiers in brackets are those of the test kit. */
#include "node.h"

#include <stdlib.h>
#include <string.h>

#define MS INT64_C(1000000)

const parameters_t default_parameters = {100.0, MAX_PACKET, 0x1111, 3000.0, 32, 32, 15, 1000, 20, 1000, 50};

static const uint8_t *own(const node_t *node)
{
    return node->id;
}

static bool same_node(const uint8_t *one, const uint8_t *other)
{
    return memcmp(one, other, NODE_ID_SIZE) == 0;
}

static int64_t ns(double ms)
{
    return ms < 1e12 ? (int64_t)(ms * (double)MS) : (int64_t)1e18;
}

/* ---- BP: clients and their payloads -------------------------------------------------------------------------------- */

client_t *bp_client(node_t *node, int64_t protocol_id)
{
    size_t i;
    for (i = 0; i < MAX_CLIENTS; i++)
        if (node->clients[i].used && node->clients[i].protocol_id == protocol_id)
            return &node->clients[i];
    return NULL;
}

static void drop_first(client_t *client)
{
    payload_t *const first = client->first;
    client->first = first->next;
    client->waiting -= 1;
    free(first);
}

static void drop_all(client_t *client)
{
    while (client->first != NULL)
        drop_first(client);
}

static bool is_queue(bp_mode_t mode)
{
    return mode == DROPTAIL || mode == DROPHEAD;
}

/* [BP-REG-02] to [BP-REG-09]: the first check that fails decides. */
bp_status_t bp_register(node_t *node, const client_t *wanted, node_time_t t)
{
    const int64_t overhead = (int64_t)(DCP_BP_HEADER_SIZE + DCP_PAYLOAD_SIZE);
    size_t i;
    if (bp_client(node, wanted->protocol_id) != NULL)
        return BP_PROTOCOL_ALREADY_REGISTERED;
    if (wanted->max_payload_size <= 0 || wanted->max_payload_size > node->parameters.max_packet_size - overhead)
        return BP_ILLEGAL_MAX_PAYLOAD_SIZE;
    if (is_queue(wanted->mode) && wanted->max_entries <= 0)
        return BP_ILLEGAL_DROPPING_QUEUE_SIZE;
    if (wanted->mode == UNKNOWN_MODE)
        return BP_UNKNOWN_QUEUEING_MODE;
    for (i = 0; i < MAX_CLIENTS && node->clients[i].used; i++)
        ;
    if (i == MAX_CLIENTS)
        return BP_ILLEGAL_DROPPING_QUEUE_SIZE; /* the specification has no status for a full table */
    node->clients[i] = *wanted;
    node->clients[i].used = true;
    node->clients[i].registered = t.wall;
    node->clients[i].first = NULL;
    node->clients[i].waiting = 0;
    return BP_OK;
}

bp_status_t bp_deregister(node_t *node, int64_t protocol_id)
{
    client_t *const client = bp_client(node, protocol_id);
    if (client == NULL)
        return BP_UNKNOWN_PROTOCOL;
    drop_all(client);
    client->used = false;
    return BP_OK;
}

bp_status_t bp_clear(node_t *node, int64_t protocol_id)
{
    client_t *const client = bp_client(node, protocol_id);
    if (client == NULL)
        return BP_UNKNOWN_PROTOCOL;
    drop_all(client);
    return BP_OK;
}

/* [BP-TXP-01] to [BP-TXP-06] */
bp_status_t bp_transmit(node_t *node, int64_t protocol_id, const uint8_t *payload, size_t size)
{
    client_t *const client = bp_client(node, protocol_id);
    payload_t *kept, **end;
    if (client == NULL)
        return BP_UNKNOWN_PROTOCOL;
    if ((int64_t)size > client->max_payload_size || size > MAX_PACKET)
        return BP_PAYLOAD_TOO_LARGE;
    if (size == 0)
        return BP_EMPTY_PAYLOAD;
    if (client->mode == DROPTAIL && client->waiting >= client->max_entries)
        return BP_OK;
    if (client->mode == DROPHEAD && client->waiting >= client->max_entries)
        drop_first(client);
    if (!is_queue(client->mode))
        drop_all(client);
    kept = malloc(sizeof *kept);
    if (kept == NULL)
        return BP_OK; /* OK does not promise transmission [BP-TXP-09] */
    memcpy(kept->octets, payload, size);
    kept->size = size;
    kept->next = NULL;
    for (end = &client->first; *end != NULL; end = &(*end)->next)
        ;
    *end = kept;
    client->waiting += 1;
    return BP_OK;
}

/* ---- BP: beacons ------------------------------------------------------------------------------------------------------ */

/* The time between two beacons: 90 % to 110 % of the period, on average the period [BP-TX-01]. */
static int64_t interval(node_t *node)
{
    node->random = node->random * 1664525u + 1013904223u;
    return ns(node->parameters.beacon_period * (0.9 + 0.2 * (double)(node->random >> 8) / 16777216.0));
}

void bp_activate(node_t *node, bool active, node_time_t t)
{
    if (active && !node->bp_active)
        node->beacon_due = t.now + interval(node);
    node->bp_active = active;
}

void bp_set_period(node_t *node, double period, node_time_t t)
{
    node->parameters.beacon_period = period;
    if (node->beacon_due > t.now + ns(period))
        node->beacon_due = t.now + interval(node);
}

/* Add the first payload of a client to a beacon, if it fits [BP-TX-04]. */
static bool add_payload(dcp_writer_t *w, client_t *client)
{
    const payload_t *const first = client->first;
    dcp_payload_t block;
    if (first == NULL || w->payloads_written == 255u || w->size - w->at < DCP_PAYLOAD_SIZE + first->size)
        return false;
    memset(&block, 0, sizeof block);
    block.protocol_id = client->protocol_id;
    if (!dcp_begin_payload(w, &block) || !dcp_add_octets(w, first->octets, first->size) || !dcp_end_payload(w, &block))
        return false;
    if (client->mode != REPEAT)
        drop_first(client);
    return true;
}

static void vd_transmitted(node_t *node);

static void send_beacon(node_t *node, node_time_t t)
{
    uint8_t octets[MAX_PACKET];
    uint16_t told[255];
    size_t i, served = 0;
    dcp_bp_header_t bp;
    dcp_writer_t w;
    const size_t begun = node->first_client;
    memset(&bp, 0, sizeof bp);
    bp.sender_id = own(node);
    bp.network_id = (uint16_t)node->parameters.network_id;
    bp.seqno = node->bp_seqno;
    dcp_write_to(&w, octets, (size_t)node->parameters.max_packet_size);
    if (!dcp_begin_beacon(&w, &bp))
        return;
    for (i = 0; i < MAX_CLIENTS; i++) {
        client_t *const client = &node->clients[(begun + i) % MAX_CLIENTS];
        bool added = false;
        if (!client->used)
            continue;
        while (add_payload(&w, client)) {
            added = true;
            if (!client->several || !is_queue(client->mode)) /* [BP-QM-07] */
                break;
        }
        if (added)
            told[served++] = client->protocol_id;
        if (client->first != NULL && node->first_client == begun)
            node->first_client = (begun + i) % MAX_CLIENTS + (added ? 1u : 0u); /* whoever waits is next */
    }
    node->first_client %= MAX_CLIENTS;
    if (!dcp_end_beacon(&w)) /* without a payload there is no beacon [BP-FMT-03] [BP-HDR-09] */
        return;
    node->bp_seqno += 1u;
    node->events->send(node->user, octets, w.at);
    for (i = 0; i < served; i++) {
        const client_t *const client = bp_client(node, told[i]);
        node->events->transmitted(node->user, told[i], t.wall + (node->beacon_due - t.now));
        if (client != NULL && client->own && told[i] == DCP_PROTOCOL_VARDIS)
            vd_transmitted(node);
    }
}

static void srp_receive(node_t *node, dcp_octets_t content, node_time_t t);
static void vd_receive(node_t *node, dcp_octets_t content, node_time_t t);

/* [BP-RX-01] to [BP-RX-16]: what is wrong is dropped, and everything after it. */
void node_receive(node_t *node, const uint8_t *octets, size_t size, node_time_t t)
{
    dcp_beacon_t beacon;
    dcp_payload_t block;
    dcp_problem_t problem;
    if (!node->bp_active || !dcp_read_beacon(octets, size, &beacon, &problem))
        return;
    if (beacon.bp.network_id != node->parameters.network_id || same_node(beacon.bp.sender_id, own(node)))
        return;
    while (dcp_next_payload(&beacon.payloads, &block, &problem)) {
        const client_t *const client = bp_client(node, block.protocol_id);
        if (client == NULL)
            continue;
        node->events->received(node->user, block.protocol_id, block.content.data, block.content.size,
                               beacon.bp.sender_id);
        if (client->own && block.protocol_id == DCP_PROTOCOL_SRP)
            srp_receive(node, block.content, t);
        if (client->own && block.protocol_id == DCP_PROTOCOL_VARDIS)
            vd_receive(node, block.content, t);
    }
}

/* ---- SRP ---------------------------------------------------------------------------------------------------------------- */

/* False: SRP is not registered with BP [SRP-SRV-01]. */
bool srp_update(node_t *node, const dcp_safety_data_t *data, node_time_t t)
{
    const client_t *const client = bp_client(node, DCP_PROTOCOL_SRP);
    uint8_t octets[DCP_EXTENDED_SAFETY_DATA_SIZE];
    dcp_extended_safety_data_t report;
    dcp_writer_t w;
    if (client == NULL || !client->own)
        return false;
    memset(&report, 0, sizeof report);
    report.s_data = *data;
    report.node_id = own(node);
    report.t_stamp = (uint64_t)t.wall;
    report.seqno = node->srp_seqno++;
    dcp_write_to(&w, octets, sizeof octets);
    if (dcp_add_extended_safety_data(&w, &report))
        (void)bp_transmit(node, DCP_PROTOCOL_SRP, octets, w.at);
    return true;
}

static void srp_receive(node_t *node, dcp_octets_t content, node_time_t t)
{
    dcp_extended_safety_data_t report;
    dcp_problem_t problem;
    neighbour_t *found = NULL;
    bool is_new;
    size_t i;
    if (!dcp_read_extended_safety_data(content.data, content.size, &report, &problem)
        || same_node(report.node_id, own(node))) /* [SRP-RX-01] [SRP-RX-02] */
        return;
    for (i = 0; i < MAX_NEIGHBOURS; i++) {
        neighbour_t *const entry = &node->neighbours[i];
        if (entry->used && same_node(entry->node_id, report.node_id)) {
            found = entry;
            break;
        }
        if (!entry->used && found == NULL)
            found = entry;
    }
    if (found == NULL)
        return;
    is_new = !found->used;
    found->used = true;
    memcpy(found->node_id, report.node_id, NODE_ID_SIZE);
    found->report = report;
    found->report.node_id = found->node_id;
    found->received = t;
    node->events->neighbour_seen(node->user, found->node_id, is_new);
}

/* [SRP-RUN-02]; node_poll calls it ten times in each timeout [SRP-RUN-01]. */
static void srp_traverse(node_t *node, node_time_t t)
{
    size_t i;
    for (i = 0; i < MAX_NEIGHBOURS; i++) {
        neighbour_t *const entry = &node->neighbours[i];
        if (entry->used && t.now - entry->received.now > ns(node->parameters.neighbour_timeout)) {
            entry->used = false;
            node->events->neighbour_expired(node->user, entry->node_id);
        }
    }
}

/* ---- VarDis: queues and database ------------------------------------------------------------------------------------- */

static bool queued(const queue_t *queue, uint8_t id)
{
    return memchr(queue->ids, id, queue->count) != NULL;
}

static void append(queue_t *queue, uint8_t id)
{
    if (!queued(queue, id))
        queue->ids[queue->count++] = id;
}

static void drop(queue_t *queue, uint8_t id)
{
    uint8_t *const place = memchr(queue->ids, id, queue->count);
    if (place != NULL) {
        queue->count -= 1u;
        memmove(place, place + 1, (size_t)(queue->ids + queue->count - place));
    }
}

static void drop_everywhere(node_t *node, uint8_t id)
{
    drop(&node->create_q, id);
    drop(&node->delete_q, id);
    drop(&node->update_q, id);
    drop(&node->summary_q, id);
    drop(&node->req_create_q, id);
    drop(&node->req_upd_q, id);
}

static variable_t *lookup(node_t *node, uint8_t id)
{
    return node->variables[id].used ? &node->variables[id] : NULL;
}

static bool is_own(const node_t *node, const variable_t *variable)
{
    return same_node(variable->prod_id, own(node));
}

/* Sequence numbers are circular; half of the circle away is neither newer nor older. */
static bool newer(uint8_t one, uint8_t other)
{
    const uint8_t distance = (uint8_t)(one - other);
    return distance >= 1u && distance <= 127u;
}

static void set_value(variable_t *variable, dcp_octets_t value, node_time_t t)
{
    memcpy(variable->value, value.data, value.size);
    variable->record.upd.value.data = variable->value;
    variable->record.upd.value.size = value.size;
    variable->changed = t;
}

/* Store a new variable, and disseminate it: RTDB-Create and VarCreate do the same [VD-CRE-10] [VD-PC-07]. */
static void store(node_t *node, const dcp_var_create_t *record, node_time_t t)
{
    const uint8_t id = record->spec.var_id;
    variable_t *const variable = &node->variables[id];
    memset(variable, 0, sizeof *variable);
    variable->used = true;
    variable->record = *record;
    memcpy(variable->prod_id, record->spec.prod_id, NODE_ID_SIZE);
    variable->record.spec.prod_id = variable->prod_id;
    memcpy(variable->descr, record->spec.descr.data, record->spec.descr.size);
    variable->record.spec.descr.data = variable->descr;
    variable->record.upd.var_id = id;
    set_value(variable, record->upd.value, t);
    variable->count_create = record->spec.rep_cnt;
    drop_everywhere(node, id);
    append(&node->create_q, id);
    append(&node->summary_q, id);
    node->events->variable(node->user, CREATED, variable);
}

/* Mark a variable as deleted, and disseminate that [VD-DEL-05] [VD-PD-04] [VD-SCR-04]. */
static void mark_deleted(node_t *node, variable_t *variable)
{
    const uint8_t id = variable->record.spec.var_id;
    variable->deleted = true;
    variable->count_create = variable->count_update = 0;
    variable->count_delete = variable->record.spec.rep_cnt;
    drop_everywhere(node, id);
    append(&node->delete_q, id);
    node->events->variable(node->user, DELETED, variable);
}

static void schedule_update(node_t *node, variable_t *variable)
{
    variable->count_update = variable->record.spec.rep_cnt;
    append(&node->update_q, variable->record.spec.var_id);
}

/* ---- VarDis: services ------------------------------------------------------------------------------------------------- */

static bool vd_registered(node_t *node)
{
    const client_t *const client = bp_client(node, DCP_PROTOCOL_VARDIS);
    return client != NULL && client->own;
}

bool vd_serves(node_t *node)
{
    return node->vd_active && vd_registered(node);
}

static size_t longest(int64_t parameter)
{
    return parameter < (int64_t)MAX_TEXT ? (size_t)parameter : MAX_TEXT;
}

vd_status_t vd_create(node_t *node, uint8_t var_id, int64_t rep_cnt, dcp_octets_t descr, dcp_octets_t value,
                      uint16_t timeout, node_time_t t)
{
    const variable_t *const known = lookup(node, var_id);
    dcp_var_create_t record;
    if (!vd_serves(node))
        return VD_INACTIVE;
    if (known != NULL && !is_own(node, known))
        return VD_VARIABLE_EXISTS;
    if (descr.size > longest(node->parameters.max_description_length))
        return VD_DESCRIPTION_TOO_LONG;
    if (value.size > longest(node->parameters.max_value_length))
        return VD_VALUE_TOO_LONG;
    if (value.size == 0)
        return VD_EMPTY_VALUE;
    if (rep_cnt < 1 || rep_cnt > node->parameters.max_repetitions)
        return VD_ILLEGAL_REPCOUNT;
    memset(&record, 0, sizeof record);
    record.spec.var_id = var_id;
    record.spec.prod_id = own(node);
    record.spec.rep_cnt = (uint8_t)rep_cnt;
    record.spec.creation_time = (uint64_t)t.wall;
    /* Receivers only accept a later time than the one they know, also if our clock was set back. */
    if (known != NULL && record.spec.creation_time <= known->record.spec.creation_time)
        record.spec.creation_time = known->record.spec.creation_time + 1;
    record.spec.timeout = timeout;
    record.spec.descr = descr;
    record.upd.value = value;
    store(node, &record, t);
    return VD_OK;
}

vd_status_t vd_update(node_t *node, uint8_t var_id, dcp_octets_t value, node_time_t t)
{
    variable_t *const variable = lookup(node, var_id);
    if (!vd_serves(node))
        return VD_INACTIVE;
    if (variable == NULL)
        return VD_DOES_NOT_EXIST;
    if (!is_own(node, variable))
        return VD_NOT_PRODUCER;
    if (variable->deleted)
        return VD_IS_DELETED;
    if (value.size > longest(node->parameters.max_value_length))
        return VD_VALUE_TOO_LONG;
    if (value.size == 0)
        return VD_EMPTY_VALUE;
    variable->record.upd.seqno = (uint8_t)(variable->record.upd.seqno + 1u);
    set_value(variable, value, t);
    schedule_update(node, variable);
    node->events->variable(node->user, UPDATED, variable);
    return VD_OK;
}

vd_status_t vd_delete(node_t *node, uint8_t var_id, node_time_t t)
{
    variable_t *const variable = lookup(node, var_id);
    (void)t;
    if (!vd_serves(node))
        return VD_INACTIVE;
    if (variable == NULL)
        return VD_DOES_NOT_EXIST;
    if (!is_own(node, variable))
        return VD_NOT_PRODUCER;
    if (variable->deleted)
        return VD_IS_DELETED;
    mark_deleted(node, variable);
    return VD_OK;
}

/* Find a variable for RTDB-Read and RTDB-DescribeVariable, which shows deleted ones, too. */
vd_status_t vd_read(node_t *node, uint8_t var_id, const variable_t **found)
{
    const variable_t *const variable = lookup(node, var_id);
    *found = variable;
    if (!vd_serves(node))
        return VD_INACTIVE;
    if (variable == NULL)
        return VD_DOES_NOT_EXIST;
    return variable->deleted ? VD_IS_DELETED : VD_OK;
}

/* ---- VarDis: composing payloads ------------------------------------------------------------------------------------ */

/* Add a record for the variable at the head of the queue. False: it does not fit. */
static bool add_record(node_t *node, dcp_writer_t *w, unsigned type, uint8_t id)
{
    variable_t *const variable = lookup(node, id);
    const dcp_var_create_t *const record = variable != NULL ? &variable->record : NULL;
    dcp_var_delete_t deletion;
    dcp_var_req_create_t creation;
    dcp_var_summ_t summary;
    dcp_var_req_update_t request;
    switch (type) {
    case DCP_IC_CREATE_VARIABLES:
        if (record == NULL || !dcp_add_var_create(w, record))
            return false;
        if (--variable->count_create != 0)
            append(&node->create_q, id);
        return true;
    case DCP_IC_DELETE_VARIABLES:
        deletion.var_id = id;
        if (record == NULL || !dcp_add_var_delete(w, &deletion))
            return false;
        if (--variable->count_delete != 0)
            append(&node->delete_q, id);
        return true;
    case DCP_IC_REQUEST_VARCREATES:
        creation.var_id = id;
        return dcp_add_var_req_create(w, &creation);
    case DCP_IC_SUMMARIES:
        if (record == NULL)
            return false;
        summary.var_id = id;
        summary.seqno = record->upd.seqno;
        if (!dcp_add_var_summ(w, &summary))
            return false;
        append(&node->summary_q, id);
        return true;
    case DCP_IC_UPDATES:
        if (record == NULL || !dcp_add_var_update(w, &record->upd))
            return false;
        if (--variable->count_update != 0)
            append(&node->update_q, id);
        return true;
    default:
        if (record == NULL)
            return false;
        request.var_id = id;
        request.seqno = record->upd.seqno;
        return dcp_add_var_req_update(w, &request);
    }
}

/* Add a container with as many records as there are and fit, each variable once [VD-PAY-02] [VD-PAY-03] [VD-PAY-06]. */
static void add_container(node_t *node, dcp_writer_t *w, unsigned type, queue_t *queue, size_t most)
{
    dcp_container_t container;
    size_t left;
    memset(&container, 0, sizeof container);
    container.ic_type = (uint8_t)type;
    if (queue->count == 0 || !dcp_begin_container(w, &container))
        return;
    for (left = queue->count < most ? queue->count : most; left != 0; left--) {
        const uint8_t id = queue->ids[0];
        drop(queue, id);
        if (!add_record(node, w, type, id)) {
            memmove(queue->ids + 1, queue->ids, queue->count);
            queue->ids[0] = id;
            queue->count += 1u;
            break;
        }
    }
    (void)dcp_end_container(w);
}

/* Compose a payload and hand it to BP, if there is something to say [VD-PAY-01] [VD-PAY-04]. */
static void compose(node_t *node)
{
    const client_t *const client = bp_client(node, DCP_PROTOCOL_VARDIS);
    const parameters_t *const p = &node->parameters;
    uint8_t octets[MAX_PACKET];
    dcp_writer_t w;
    int64_t size = p->max_payload_size;
    if (!vd_serves(node))
        return;
    if (size > client->max_payload_size)
        size = client->max_payload_size;
    dcp_write_to(&w, octets, (size_t)size);
    add_container(node, &w, DCP_IC_CREATE_VARIABLES, &node->create_q, 255);
    add_container(node, &w, DCP_IC_DELETE_VARIABLES, &node->delete_q, 255);
    add_container(node, &w, DCP_IC_REQUEST_VARCREATES, &node->req_create_q, 255);
    add_container(node, &w, DCP_IC_SUMMARIES, &node->summary_q, p->max_summaries < 255 ? (size_t)p->max_summaries : 255);
    add_container(node, &w, DCP_IC_UPDATES, &node->update_q, 255);
    add_container(node, &w, DCP_IC_REQUEST_VARUPDATES, &node->req_upd_q, 255);
    if (w.at != 0)
        (void)bp_transmit(node, DCP_PROTOCOL_VARDIS, octets, w.at);
}

static void vd_transmitted(node_t *node)
{
    compose(node);
}

/* [VD-SCR-01] to [VD-SCR-05] */
static void vd_scrub(node_t *node, node_time_t t)
{
    size_t i;
    if (!vd_serves(node))
        return;
    for (i = 0; i < MAX_VARIABLES; i++) {
        variable_t *const variable = &node->variables[i];
        const int64_t timeout = variable->record.spec.timeout * MS;
        if (variable->used && !variable->deleted && timeout != 0 && t.now - variable->changed.now > timeout)
            mark_deleted(node, variable);
    }
}

/* ---- VarDis: received records ----------------------------------------------------------------------------------------- */

static bool good_length(dcp_octets_t octets, int64_t most)
{
    return octets.size != 0 && octets.size <= longest(most);
}

static void receive_create(node_t *node, const dcp_var_create_t *record, node_time_t t)
{
    const variable_t *const known = lookup(node, record->spec.var_id);
    if (record->upd.var_id != record->spec.var_id)
        return;
    if (known != NULL && record->spec.creation_time <= known->record.spec.creation_time) /* [VD-PC-01] */
        return;
    if (same_node(record->spec.prod_id, own(node)))
        return;
    if (!good_length(record->upd.value, node->parameters.max_value_length)
        || !good_length(record->spec.descr, node->parameters.max_description_length) || record->spec.rep_cnt == 0
        || record->spec.rep_cnt > node->parameters.max_repetitions)
        return;
    store(node, record, t);
}

static void receive_delete(node_t *node, const dcp_var_delete_t *record)
{
    variable_t *const variable = lookup(node, record->var_id);
    if (variable != NULL && !variable->deleted && !is_own(node, variable))
        mark_deleted(node, variable);
}

static void receive_update(node_t *node, const dcp_var_update_t *record, node_time_t t)
{
    variable_t *const variable = lookup(node, record->var_id);
    if (variable == NULL) {
        append(&node->req_create_q, record->var_id);
        return;
    }
    if (variable->deleted || is_own(node, variable)
        || !good_length(record->value, node->parameters.max_value_length))
        return;
    if (newer(record->seqno, variable->record.upd.seqno)) {
        variable->record.upd.seqno = record->seqno;
        set_value(variable, record->value, t);
        schedule_update(node, variable);
        drop(&node->req_upd_q, record->var_id);
        node->events->variable(node->user, UPDATED, variable);
    } else if (newer(variable->record.upd.seqno, record->seqno) && !queued(&node->update_q, record->var_id)) {
        schedule_update(node, variable); /* the sender has an old value [VD-PU-06] */
    }
}

static void receive_summary(node_t *node, const dcp_var_summ_t *record)
{
    variable_t *const variable = lookup(node, record->var_id);
    if (variable == NULL) {
        append(&node->req_create_q, record->var_id);
        return;
    }
    if (variable->deleted || is_own(node, variable))
        return;
    if (newer(record->seqno, variable->record.upd.seqno))
        append(&node->req_upd_q, record->var_id);
    else if (newer(variable->record.upd.seqno, record->seqno) && !queued(&node->update_q, record->var_id))
        schedule_update(node, variable);
}

static void receive_req_update(node_t *node, const dcp_var_req_update_t *record)
{
    variable_t *const variable = lookup(node, record->var_id);
    if (variable == NULL)
        append(&node->req_create_q, record->var_id);
    else if (!variable->deleted && newer(variable->record.upd.seqno, record->seqno))
        schedule_update(node, variable);
}

static void receive_req_create(node_t *node, const dcp_var_req_create_t *record)
{
    variable_t *const variable = lookup(node, record->var_id);
    if (variable == NULL) {
        append(&node->req_create_q, record->var_id);
    } else if (!variable->deleted) {
        variable->count_create = variable->record.spec.rep_cnt;
        append(&node->create_q, record->var_id);
    }
}

static void receive_records(node_t *node, dcp_container_t *container, node_time_t t)
{
    union {
        dcp_var_create_t create;
        dcp_var_delete_t deletion;
        dcp_var_update_t update;
        dcp_var_summ_t summary;
        dcp_var_req_update_t req_update;
        dcp_var_req_create_t req_create;
    } record;
    switch (container->ic_type) {
    case DCP_IC_CREATE_VARIABLES:
        while (dcp_next_var_create(&container->records, &record.create))
            receive_create(node, &record.create, t);
        break;
    case DCP_IC_DELETE_VARIABLES:
        while (dcp_next_var_delete(&container->records, &record.deletion))
            receive_delete(node, &record.deletion);
        break;
    case DCP_IC_UPDATES:
        while (dcp_next_var_update(&container->records, &record.update))
            receive_update(node, &record.update, t);
        break;
    case DCP_IC_SUMMARIES:
        while (dcp_next_var_summ(&container->records, &record.summary))
            receive_summary(node, &record.summary);
        break;
    case DCP_IC_REQUEST_VARUPDATES:
        while (dcp_next_var_req_update(&container->records, &record.req_update))
            receive_req_update(node, &record.req_update);
        break;
    default:
        while (dcp_next_var_req_create(&container->records, &record.req_create))
            receive_req_create(node, &record.req_create);
        break;
    }
}

/* Extract all containers first, up to the first wrong one, then process them type by type [VD-RX-01] [VD-RX-08]. */
static void vd_receive(node_t *node, dcp_octets_t content, node_time_t t)
{
    static const uint8_t order[] = {DCP_IC_CREATE_VARIABLES, DCP_IC_DELETE_VARIABLES,    DCP_IC_UPDATES,
                                    DCP_IC_SUMMARIES,        DCP_IC_REQUEST_VARUPDATES, DCP_IC_REQUEST_VARCREATES};
    dcp_list_t list = dcp_containers(content.data, content.size);
    dcp_container_t container;
    dcp_problem_t problem;
    size_t i, good = 0;
    if (!vd_serves(node))
        return;
    while (dcp_next_container(&list, &container, &problem))
        good++;
    for (i = 0; i < sizeof order; i++) {
        size_t number;
        list = dcp_containers(content.data, content.size);
        for (number = 0; number < good && dcp_next_container(&list, &container, &problem); number++)
            if (container.ic_type == order[i])
                receive_records(node, &container, t);
    }
}

/* ---- the node ------------------------------------------------------------------------------------------------------------ */

static void register_own(node_t *node, uint16_t protocol_id, const char *name, int64_t size, bp_mode_t mode,
                         node_time_t t)
{
    client_t client;
    memset(&client, 0, sizeof client);
    client.own = true;
    client.protocol_id = protocol_id;
    strcpy(client.name, name);
    client.max_payload_size = size;
    client.mode = mode;
    client.max_entries = is_queue(mode) ? 20 : 0;
    (void)bp_register(node, &client, t);
}

/* The state after the start. */
void node_reset(node_t *node, node_time_t t)
{
    const node_events_t *const events = node->events;
    void *const user = node->user;
    uint8_t id[NODE_ID_SIZE];
    const uint32_t random = node->random;
    size_t i;
    for (i = 0; i < MAX_CLIENTS; i++)
        if (node->clients[i].used)
            drop_all(&node->clients[i]);
    memcpy(id, node->id, sizeof id);
    memset(node, 0, sizeof *node);
    memcpy(node->id, id, sizeof id);
    node->events = events;
    node->user = user;
    node->random = random;
    node->parameters = default_parameters;
    node->bp_active = node->vd_active = true;
    node->beacon_due = t.now + interval(node);
    node->traversal_due = node->scrubbing_due = node->check_due = t.now;
    register_own(node, DCP_PROTOCOL_SRP, "SRP -- State Reporting Protocol V2.0", DCP_EXTENDED_SAFETY_DATA_SIZE, ONCE, t);
    register_own(node, DCP_PROTOCOL_VARDIS, "VarDis -- Variable Dissemination Protocol V2.0",
                 node->parameters.max_payload_size, DROPHEAD, t);
}

void node_init(node_t *node, const uint8_t *id, const node_events_t *events, void *user, node_time_t t)
{
    memset(node, 0, sizeof *node);
    memcpy(node->id, id, NODE_ID_SIZE);
    node->events = events;
    node->user = user;
    node->random = (uint32_t)t.now ^ (uint32_t)id[5];
    node_reset(node, t);
}

static int64_t earlier(int64_t one, int64_t other)
{
    return one < other ? one : other;
}

int64_t node_due(const node_t *node)
{
    const int64_t timers = earlier(node->traversal_due, earlier(node->scrubbing_due, node->check_due));
    return node->bp_active ? earlier(node->beacon_due, timers) : timers;
}

void node_poll(node_t *node, node_time_t t)
{
    const parameters_t *const p = &node->parameters;
    if (t.now >= node->scrubbing_due) {
        node->scrubbing_due = t.now + p->scrubbing_period * MS;
        vd_scrub(node, t);
    }
    if (t.now >= node->traversal_due) {
        node->traversal_due = t.now + ns(p->neighbour_timeout / 10.0);
        srp_traverse(node, t);
    }
    if (t.now >= node->check_due) {
        const client_t *const client = bp_client(node, DCP_PROTOCOL_VARDIS);
        node->check_due = t.now + p->buffer_check_period * MS;
        if (client != NULL && client->waiting == 0) /* [VD-RUN-02] */
            compose(node);
    }
    if (node->bp_active && t.now >= node->beacon_due) {
        node->beacon_due += interval(node);
        if (node->beacon_due < t.now)
            node->beacon_due = t.now + interval(node);
        send_beacon(node, t);
    }
}
