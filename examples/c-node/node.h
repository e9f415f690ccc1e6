/* A DCP node without input or output: BP, SRP and VarDis of the specification 2.0 in one state machine.
 *
 * Times are nanoseconds: now is monotonic, wall counts from 1970. Call any function, then node_poll when node_due has
 * come. Events are reported while a call runs. */
#ifndef NODE_H
#define NODE_H

#include "dcp_codec.h"

#define NODE_ID_SIZE 6u
#define MAX_CLIENTS 512u
#define MAX_NEIGHBOURS 2048u
#define MAX_VARIABLES 256u /* VarIdT has one octet in this profile */
#define MAX_TEXT 255u
#define MAX_PACKET 1500u

typedef struct node_time {
    int64_t now;
    int64_t wall;
} node_time_t;

typedef enum bp_mode { ONCE, REPEAT, DROPTAIL, DROPHEAD, UNKNOWN_MODE } bp_mode_t;

typedef enum bp_status {
    BP_OK,
    BP_PROTOCOL_ALREADY_REGISTERED,
    BP_ILLEGAL_MAX_PAYLOAD_SIZE,
    BP_ILLEGAL_DROPPING_QUEUE_SIZE,
    BP_UNKNOWN_QUEUEING_MODE,
    BP_UNKNOWN_PROTOCOL,
    BP_PAYLOAD_TOO_LARGE,
    BP_EMPTY_PAYLOAD
} bp_status_t;

typedef enum vd_status {
    VD_OK,
    VD_INACTIVE,
    VD_VARIABLE_EXISTS,
    VD_DESCRIPTION_TOO_LONG,
    VD_VALUE_TOO_LONG,
    VD_EMPTY_VALUE,
    VD_ILLEGAL_REPCOUNT,
    VD_DOES_NOT_EXIST,
    VD_NOT_PRODUCER,
    VD_IS_DELETED
} vd_status_t;

/* A payload that waits for a beacon. */
typedef struct payload {
    struct payload *next;
    size_t size;
    uint8_t octets[MAX_PACKET];
} payload_t;

/* A registered client protocol of BP. */
typedef struct client {
    bool used;
    bool own; /* SRP or VarDis of this node */
    uint16_t protocol_id;
    char name[256];
    int64_t max_payload_size;
    bp_mode_t mode;
    int64_t max_entries;
    bool several;
    int64_t registered; /* wall */
    payload_t *first;
    int64_t waiting;
} client_t;

typedef struct neighbour {
    bool used;
    uint8_t node_id[NODE_ID_SIZE];
    dcp_extended_safety_data_t report;
    node_time_t received;
} neighbour_t;

/* An entry of the real-time database. The pointers of record lead to the buffers below it. */
typedef struct variable {
    bool used;
    bool deleted;
    dcp_var_create_t record;
    uint8_t prod_id[NODE_ID_SIZE];
    uint8_t descr[MAX_TEXT];
    uint8_t value[MAX_TEXT];
    node_time_t changed;
    uint8_t count_update, count_create, count_delete;
} variable_t;

/* Identifiers of variables, each at most once. */
typedef struct queue {
    uint8_t ids[MAX_VARIABLES];
    size_t count;
} queue_t;

typedef struct parameters {
    double beacon_period; /* ms */
    int64_t max_packet_size, network_id;
    double neighbour_timeout; /* ms */
    int64_t max_value_length, max_description_length, max_repetitions, max_payload_size, max_summaries;
    int64_t scrubbing_period, buffer_check_period; /* ms */
} parameters_t;

typedef enum variable_event { CREATED, UPDATED, DELETED } variable_event_t;

typedef struct node_events {
    void (*send)(void *user, const uint8_t *beacon, size_t size);
    void (*received)(void *user, uint16_t protocol_id, const uint8_t *payload, size_t size, const uint8_t *sender_id);
    void (*transmitted)(void *user, uint16_t protocol_id, int64_t next_beacon);
    void (*variable)(void *user, variable_event_t event, const variable_t *variable);
    void (*neighbour_seen)(void *user, const uint8_t *node_id, bool is_new);
    void (*neighbour_expired)(void *user, const uint8_t *node_id);
} node_events_t;

typedef struct node {
    const node_events_t *events;
    void *user;
    uint8_t id[NODE_ID_SIZE];
    parameters_t parameters;
    uint32_t random;
    /* BP */
    bool bp_active;
    uint32_t bp_seqno;
    client_t clients[MAX_CLIENTS];
    size_t first_client; /* the one that is served first in the next beacon */
    int64_t beacon_due;
    /* SRP */
    uint32_t srp_seqno;
    neighbour_t neighbours[MAX_NEIGHBOURS];
    int64_t traversal_due;
    /* VarDis */
    bool vd_active;
    variable_t variables[MAX_VARIABLES];
    queue_t create_q, delete_q, update_q, summary_q, req_create_q, req_upd_q;
    int64_t scrubbing_due, check_due;
} node_t;

extern const parameters_t default_parameters;

void node_init(node_t *node, const uint8_t *id, const node_events_t *events, void *user, node_time_t t);
void node_reset(node_t *node, node_time_t t);
void node_receive(node_t *node, const uint8_t *octets, size_t size, node_time_t t);
void node_poll(node_t *node, node_time_t t);
int64_t node_due(const node_t *node);

client_t *bp_client(node_t *node, int64_t protocol_id);
bp_status_t bp_register(node_t *node, const client_t *wanted, node_time_t t);
bp_status_t bp_deregister(node_t *node, int64_t protocol_id);
bp_status_t bp_transmit(node_t *node, int64_t protocol_id, const uint8_t *payload, size_t size);
bp_status_t bp_clear(node_t *node, int64_t protocol_id);
void bp_activate(node_t *node, bool active, node_time_t t);
void bp_set_period(node_t *node, double period, node_time_t t);

bool srp_update(node_t *node, const dcp_safety_data_t *data, node_time_t t);

bool vd_serves(node_t *node);
vd_status_t vd_create(node_t *node, uint8_t var_id, int64_t rep_cnt, dcp_octets_t descr, dcp_octets_t value,
                      uint16_t timeout, node_time_t t);
vd_status_t vd_update(node_t *node, uint8_t var_id, dcp_octets_t value, node_time_t t);
vd_status_t vd_delete(node_t *node, uint8_t var_id, node_time_t t);
vd_status_t vd_read(node_t *node, uint8_t var_id, const variable_t **found);

#endif
