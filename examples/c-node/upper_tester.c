/* The services of the node for the upper tester. */
#include "upper_tester.h"

#include <stdio.h>
#include <string.h>

static session_t *session(dcp_out_t *out)
{
    return out->user;
}

static node_time_t clock_of(dcp_out_t *out)
{
    return session(out)->clock();
}

static bool is(dcp_text_t text, const char *expected)
{
    return text.size == strlen(expected) && memcmp(text.data, expected, text.size) == 0;
}

/* False: the number cannot be expressed in the profile, and the error is written. */
static bool in_range(dcp_out_t *out, const char *what, int64_t value, int64_t most)
{
    char message[100];
    if (value >= 0 && value <= most)
        return true;
    (void)snprintf(message, sizeof message, "%s is 0 to %lld, not %lld", what, (long long)most, (long long)value);
    dcp_error(out, DCP_ERROR_INVALID_PARAMS, message);
    return false;
}

static bool is_protocol(dcp_out_t *out, int64_t protocol_id)
{
    return in_range(out, "a protocol identifier", protocol_id, UINT16_MAX);
}

static bool is_variable(dcp_out_t *out, int64_t var_id)
{
    return in_range(out, "a variable identifier", var_id, UINT8_MAX);
}

/* ---- the upper tester ------------------------------------------------------------------------------------------------ */

static void ut_hello(void *user, dcp_out_t *out)
{
    const node_t *const node = user;
    dcp_result(out, DCP_UT_STATUS_OK);
    dcp_put_text(out, "name", "c-node");
    dcp_put_text(out, "version", "1");
    dcp_put_text(out, "specVersion", "2.0");
    dcp_put_text(out, "profile", "dcp-2.0");
    dcp_put_node_id(out, "nodeId", node->id, NODE_ID_SIZE);
    dcp_put_methods(out, "methods", &methods);
}

static void ut_reset(void *user, dcp_out_t *out)
{
    node_reset(user, clock_of(out));
    dcp_result(out, DCP_UT_STATUS_OK);
}

static void ut_subscribe(void *user, const dcp_subscribe_params_t *params, dcp_out_t *out)
{
    subscription_t *const subscription = &session(out)->subscription;
    dcp_text_t list = params->prot_ids;
    (void)user;
    subscription->variables = params->variables;
    subscription->neighbours = params->neighbours;
    subscription->count = 0;
    while (subscription->count < MAX_SUBSCRIPTIONS
           && dcp_next_integer(&list, &subscription->prot_ids[subscription->count]))
        subscription->count += 1u;
    dcp_result(out, DCP_UT_STATUS_OK);
}

/* ---- BP ------------------------------------------------------------------------------------------------------------------ */

static const char *const mode_names[] = {"BP_QMODE_ONCE", "BP_QMODE_REPEAT", "BP_QMODE_QUEUE_DROPTAIL",
                                         "BP_QMODE_QUEUE_DROPHEAD"};

static dcp_status_t bp_status(bp_status_t status)
{
    switch (status) {
    case BP_OK: return DCP_BP_STATUS_OK;
    case BP_PROTOCOL_ALREADY_REGISTERED: return DCP_BP_STATUS_PROTOCOL_ALREADY_REGISTERED;
    case BP_ILLEGAL_MAX_PAYLOAD_SIZE: return DCP_BP_STATUS_ILLEGAL_MAX_PAYLOAD_SIZE;
    case BP_ILLEGAL_DROPPING_QUEUE_SIZE: return DCP_BP_STATUS_ILLEGAL_DROPPING_QUEUE_SIZE;
    case BP_UNKNOWN_QUEUEING_MODE: return DCP_BP_STATUS_UNKNOWN_QUEUEING_MODE;
    case BP_UNKNOWN_PROTOCOL: return DCP_BP_STATUS_UNKNOWN_PROTOCOL;
    case BP_PAYLOAD_TOO_LARGE: return DCP_BP_STATUS_PAYLOAD_TOO_LARGE;
    case BP_EMPTY_PAYLOAD: break;
    }
    return DCP_BP_STATUS_EMPTY_PAYLOAD;
}

static void bp_register_protocol(void *user, const dcp_register_protocol_params_t *params, dcp_out_t *out)
{
    node_t *const node = user;
    client_t client;
    bp_status_t status;
    int mode;
    if (!is_protocol(out, params->prot_id))
        return;
    memset(&client, 0, sizeof client);
    client.protocol_id = (uint16_t)params->prot_id;
    memcpy(client.name, params->name.data, params->name.size < sizeof client.name ? params->name.size
                                                                                  : sizeof client.name - 1u);
    client.max_payload_size = params->max_payload_size;
    client.max_entries = params->max_entries;
    client.several = params->allow_multiple_payloads;
    for (mode = ONCE; mode < UNKNOWN_MODE && !is(params->queueing_mode, mode_names[mode]); mode++)
        ;
    client.mode = (bp_mode_t)mode;
    status = bp_register(node, &client, clock_of(out));
    if (status == BP_OK)
        session(out)->registered(session(out)->number, client.protocol_id);
    dcp_result(out, bp_status(status));
    dcp_put_node_id(out, "ownNodeIdentifier", node->id, NODE_ID_SIZE);
}

static void bp_deregister_protocol(void *user, const dcp_for_protocol_params_t *params, dcp_out_t *out)
{
    if (is_protocol(out, params->prot_id))
        dcp_result(out, bp_status(bp_deregister(user, params->prot_id)));
}

static void bp_list_registered_protocols(void *user, dcp_out_t *out)
{
    const node_t *const node = user;
    size_t i;
    dcp_result(out, DCP_BP_STATUS_OK);
    dcp_begin_list(out, "protocols");
    for (i = 0; i < MAX_CLIENTS; i++) {
        const client_t *const client = &node->clients[i];
        if (!client->used)
            continue;
        dcp_begin_object(out, NULL);
        dcp_put_unsigned(out, "protocolId", client->protocol_id);
        dcp_put_text(out, "protocolName", client->name);
        dcp_put_integer(out, "maxPayloadSize", client->max_payload_size);
        dcp_put_text(out, "queueMode", mode_names[client->mode]);
        dcp_put_integer(out, "timeStampRegistration", client->registered);
        dcp_put_integer(out, "maxEntries", client->max_entries);
        dcp_put_boolean(out, "allowMultiplePayloads", client->several);
        dcp_end_object(out);
    }
    dcp_end_list(out);
}

static void bp_transmit_payload(void *user, const dcp_transmit_payload_params_t *params, dcp_out_t *out)
{
    if (is_protocol(out, params->prot_id))
        dcp_result(out, bp_status(bp_transmit(user, params->prot_id, params->payload.data, params->payload.size)));
}

static void bp_clear_buffer(void *user, const dcp_for_protocol_params_t *params, dcp_out_t *out)
{
    if (is_protocol(out, params->prot_id))
        dcp_result(out, bp_status(bp_clear(user, params->prot_id)));
}

static void bp_query_number_buffered_payloads(void *user, const dcp_for_protocol_params_t *params, dcp_out_t *out)
{
    const client_t *client;
    if (!is_protocol(out, params->prot_id))
        return;
    client = bp_client(user, params->prot_id);
    dcp_result(out, client != NULL ? DCP_BP_STATUS_OK : DCP_BP_STATUS_UNKNOWN_PROTOCOL);
    if (client != NULL)
        dcp_put_integer(out, "number", client->waiting);
}

static void bp_mgmt_activate(void *user, dcp_out_t *out)
{
    bp_activate(user, true, clock_of(out));
    dcp_result(out, DCP_BP_STATUS_OK);
}

static void bp_mgmt_deactivate(void *user, dcp_out_t *out)
{
    bp_activate(user, false, clock_of(out));
    dcp_result(out, DCP_BP_STATUS_OK);
}

/* ---- parameters -------------------------------------------------------------------------------------------------------- */

static void refuse(dcp_out_t *out, const char *name, dcp_number_t value, const char *bound, const char *requirement)
{
    char message[200];
    (void)snprintf(message, sizeof message, "%s must be %s (%s)", name, bound, requirement);
    dcp_error(out, DCP_ERROR_BAD_VALUE, message);
    dcp_begin_object(out, "data");
    dcp_put_text(out, "parameter", name);
    if (value.is_integer)
        dcp_put_integer(out, "value", value.integer);
    else
        dcp_put_real(out, "value", value.real);
    dcp_put_text(out, "bound", bound);
    dcp_put_text(out, "requirement", requirement);
    dcp_end_object(out);
}

/* Set a duration, which may have a fraction. */
static void set_duration(dcp_out_t *out, dcp_status_t ok, const char *name, const char *requirement,
                         dcp_number_t value, double *parameter)
{
    if (!(value.real > 0.0)) {
        refuse(out, name, value, "greater than 0", requirement);
        return;
    }
    *parameter = value.real;
    dcp_result(out, ok);
}

/* A parameter that is an integer, and the values that it can have. */
typedef struct integer_parameter {
    const char *name;
    const char *requirement;
    int64_t *parameter;
    int64_t least, most;
} integer_parameter_t;

static void set_integer(dcp_out_t *out, dcp_status_t ok, const integer_parameter_t *known, size_t count,
                        const dcp_set_parameter_params_t *params)
{
    char bound[60];
    size_t i;
    for (i = 0; i < count && !is(params->name, known[i].name); i++)
        ;
    if (i == count) {
        dcp_error(out, DCP_ERROR_INVALID_PARAMS, "no such parameter");
    } else if (!params->value.is_integer || params->value.integer < known[i].least
               || params->value.integer > known[i].most) {
        (void)snprintf(bound, sizeof bound, "an integer, %lld to %lld", (long long)known[i].least,
                       (long long)known[i].most);
        refuse(out, known[i].name, params->value, bound, known[i].requirement);
    } else {
        *known[i].parameter = params->value.integer;
        dcp_result(out, ok);
    }
}

static void bp_get_parameters(void *user, dcp_out_t *out)
{
    const node_t *const node = user;
    dcp_result(out, DCP_BP_STATUS_OK);
    dcp_begin_object(out, "parameters");
    dcp_put_real(out, "BPPAR_BEACON_PERIOD", node->parameters.beacon_period);
    dcp_put_integer(out, "BPPAR_MAXIMUM_PACKET_SIZE", node->parameters.max_packet_size);
    dcp_put_integer(out, "BPPAR_NETWORK_ID", node->parameters.network_id);
    dcp_put_integer(out, "UWB-MaxPacketSize", MAX_PACKET);
    dcp_put_node_id(out, "ownNodeIdentifier", node->id, NODE_ID_SIZE);
    dcp_end_object(out);
}

static void bp_set_parameter(void *user, const dcp_set_parameter_params_t *params, dcp_out_t *out)
{
    node_t *const node = user;
    parameters_t *const p = &node->parameters;
    const integer_parameter_t known[] = {
        {"BPPAR_MAXIMUM_PACKET_SIZE", "BP-PAR-04", &p->max_packet_size, DCP_BP_HEADER_SIZE + DCP_PAYLOAD_SIZE,
         MAX_PACKET},
        {"BPPAR_NETWORK_ID", "BP-PAR-05", &p->network_id, 0, UINT16_MAX},
    };
    if (is(params->name, "BPPAR_BEACON_PERIOD")) {
        double period = p->beacon_period;
        set_duration(out, DCP_BP_STATUS_OK, "BPPAR_BEACON_PERIOD", "BP-PAR-03", params->value, &period);
        bp_set_period(node, period, clock_of(out));
    } else {
        set_integer(out, DCP_BP_STATUS_OK, known, sizeof known / sizeof *known, params);
    }
}

static void srp_get_parameters(void *user, dcp_out_t *out)
{
    const node_t *const node = user;
    dcp_result(out, DCP_SRP_STATUS_OK);
    dcp_begin_object(out, "parameters");
    dcp_put_real(out, "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", node->parameters.neighbour_timeout);
    dcp_end_object(out);
}

static void srp_set_parameter(void *user, const dcp_set_parameter_params_t *params, dcp_out_t *out)
{
    node_t *const node = user;
    if (is(params->name, "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT")) {
        set_duration(out, DCP_SRP_STATUS_OK, "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", "SRP-PAR-01", params->value,
                     &node->parameters.neighbour_timeout);
        node->traversal_due = clock_of(out).now;
    } else {
        dcp_error(out, DCP_ERROR_INVALID_PARAMS, "no such parameter");
    }
}

static void vd_get_parameters(void *user, dcp_out_t *out)
{
    const node_t *const node = user;
    const parameters_t *const p = &node->parameters;
    dcp_result(out, DCP_VARDIS_STATUS_OK);
    dcp_begin_object(out, "parameters");
    dcp_put_integer(out, "VARDISPAR_MAX_VALUE_LENGTH", p->max_value_length);
    dcp_put_integer(out, "VARDISPAR_MAX_DESCRIPTION_LENGTH", p->max_description_length);
    dcp_put_integer(out, "VARDISPAR_MAX_REPETITIONS", p->max_repetitions);
    dcp_put_integer(out, "VARDISPAR_MAX_PAYLOAD_SIZE", p->max_payload_size);
    dcp_put_integer(out, "VARDISPAR_MAX_SUMMARIES", p->max_summaries);
    dcp_put_integer(out, "VARDISPAR_SCRUBBING_PERIOD", p->scrubbing_period);
    dcp_put_integer(out, "VARDISPAR_BUFFER_CHECK_PERIOD", p->buffer_check_period);
    dcp_end_object(out);
}

static void vd_set_parameter(void *user, const dcp_set_parameter_params_t *params, dcp_out_t *out)
{
    node_t *const node = user;
    parameters_t *const p = &node->parameters;
    const int64_t room = p->max_payload_size - (int64_t)DCP_CONTAINER_SIZE;
    const integer_parameter_t known[] = {
        {"VARDISPAR_MAX_VALUE_LENGTH", "VD-PAR-02", &p->max_value_length, 1, room < MAX_TEXT ? room : MAX_TEXT},
        {"VARDISPAR_MAX_DESCRIPTION_LENGTH", "VD-PAR-03", &p->max_description_length, 1,
         room - (int64_t)DCP_VAR_CREATE_SIZE - p->max_value_length},
        {"VARDISPAR_MAX_REPETITIONS", "VD-PAR-04", &p->max_repetitions, 1, 15},
        {"VARDISPAR_MAX_PAYLOAD_SIZE", "VD-PAR-05", &p->max_payload_size, 1,
         p->max_packet_size - (int64_t)(DCP_BP_HEADER_SIZE + DCP_PAYLOAD_SIZE)},
        {"VARDISPAR_MAX_SUMMARIES", "VD-PAR-06", &p->max_summaries, 0, room / (int64_t)DCP_VAR_SUMM_SIZE},
        {"VARDISPAR_SCRUBBING_PERIOD", "VD-PAR-07", &p->scrubbing_period, 1, 65000},
        {"VARDISPAR_BUFFER_CHECK_PERIOD", "VD-PAR-08", &p->buffer_check_period, 1, 65000},
    };
    set_integer(out, DCP_VARDIS_STATUS_OK, known, sizeof known / sizeof *known, params);
    node->scrubbing_due = node->check_due = clock_of(out).now; /* the new periods hold at once */
}

/* ---- SRP ------------------------------------------------------------------------------------------------------------------- */

static void srp_update_safety_data(void *user, const dcp_update_safety_data_params_t *params, dcp_out_t *out)
{
    dcp_result(out, srp_update(user, &params->s_data, clock_of(out)) ? DCP_SRP_STATUS_OK : DCP_SRP_STATUS_INACTIVE);
}

static void srp_neighbour_table(void *user, const dcp_neighbour_table_request_params_t *params, dcp_out_t *out)
{
    const node_t *const node = user;
    size_t i;
    if (params->has_node_id && params->node_id.size != NODE_ID_SIZE) {
        dcp_error(out, DCP_ERROR_INVALID_PARAMS, "a node identifier has 6 octets");
        return;
    }
    dcp_result(out, DCP_SRP_STATUS_OK);
    dcp_begin_list(out, "neighbours");
    for (i = 0; i < MAX_NEIGHBOURS; i++) {
        const neighbour_t *const entry = &node->neighbours[i];
        if (!entry->used || (params->has_node_id && memcmp(entry->node_id, params->node_id.data, NODE_ID_SIZE) != 0))
            continue;
        dcp_begin_object(out, NULL);
        dcp_put_node_id(out, "nodeId", entry->node_id, NODE_ID_SIZE);
        dcp_put_safety_data(out, "sData", &entry->report.s_data);
        dcp_put_unsigned(out, "tStamp", entry->report.t_stamp);
        dcp_put_unsigned(out, "seqno", entry->report.seqno);
        dcp_put_integer(out, "receptionTime", entry->received.wall);
        dcp_end_object(out);
    }
    dcp_end_list(out);
}

/* ---- VarDis -------------------------------------------------------------------------------------------------------------- */

static dcp_status_t vd_status(vd_status_t status)
{
    switch (status) {
    case VD_OK: return DCP_VARDIS_STATUS_OK;
    case VD_INACTIVE: return DCP_VARDIS_STATUS_INACTIVE;
    case VD_VARIABLE_EXISTS: return DCP_VARDIS_STATUS_VARIABLE_EXISTS;
    case VD_DESCRIPTION_TOO_LONG: return DCP_VARDIS_STATUS_VARIABLE_DESCRIPTION_TOO_LONG;
    case VD_VALUE_TOO_LONG: return DCP_VARDIS_STATUS_VALUE_TOO_LONG;
    case VD_EMPTY_VALUE: return DCP_VARDIS_STATUS_EMPTY_VALUE;
    case VD_ILLEGAL_REPCOUNT: return DCP_VARDIS_STATUS_ILLEGAL_REPCOUNT;
    case VD_DOES_NOT_EXIST: return DCP_VARDIS_STATUS_VARIABLE_DOES_NOT_EXIST;
    case VD_NOT_PRODUCER: return DCP_VARDIS_STATUS_NOT_PRODUCER;
    case VD_IS_DELETED: break;
    }
    return DCP_VARDIS_STATUS_VARIABLE_IS_DELETED;
}

static void put_specification(dcp_out_t *out, const variable_t *variable)
{
    const dcp_var_spec_t *const spec = &variable->record.spec;
    dcp_put_unsigned(out, "varId", spec->var_id);
    dcp_put_node_id(out, "prodId", spec->prod_id, NODE_ID_SIZE);
    dcp_put_unsigned(out, "repCnt", spec->rep_cnt);
    dcp_put_description(out, spec->descr.data, spec->descr.size);
    dcp_put_unsigned(out, "creationTime", spec->creation_time);
    dcp_put_unsigned(out, "timeout", spec->timeout);
    dcp_put_boolean(out, "isDeleted", variable->deleted);
    dcp_put_integer(out, "tStamp", variable->changed.wall);
}

static void rtdb_describe_database(void *user, dcp_out_t *out)
{
    node_t *const node = user;
    size_t i;
    if (!vd_serves(node)) {
        dcp_result(out, DCP_VARDIS_STATUS_INACTIVE);
        return;
    }
    dcp_result(out, DCP_VARDIS_STATUS_OK);
    dcp_begin_list(out, "variables");
    for (i = 0; i < MAX_VARIABLES; i++) {
        if (node->variables[i].used) {
            dcp_begin_object(out, NULL);
            put_specification(out, &node->variables[i]);
            dcp_end_object(out);
        }
    }
    dcp_end_list(out);
}

static void rtdb_describe_variable(void *user, const dcp_for_variable_params_t *params, dcp_out_t *out)
{
    const variable_t *variable;
    vd_status_t status;
    if (!is_variable(out, params->var_id))
        return;
    status = vd_read(user, (uint8_t)params->var_id, &variable);
    if (status != VD_OK && status != VD_IS_DELETED) {
        dcp_result(out, vd_status(status));
        return;
    }
    dcp_result(out, DCP_VARDIS_STATUS_OK);
    dcp_begin_object(out, "variable");
    put_specification(out, variable);
    dcp_put_octets_hex(out, "value", variable->record.upd.value.data, variable->record.upd.value.size);
    dcp_put_unsigned(out, "seqno", variable->record.upd.seqno);
    dcp_put_unsigned(out, "countUpdate", variable->count_update);
    dcp_put_unsigned(out, "countCreate", variable->count_create);
    dcp_put_unsigned(out, "countDelete", variable->count_delete);
    dcp_end_object(out);
}

static void rtdb_create(void *user, const dcp_create_params_t *params, dcp_out_t *out)
{
    dcp_octets_t descr;
    if (!is_variable(out, params->var_id) || !in_range(out, "a timeout", params->timeout, UINT16_MAX))
        return;
    descr.data = (const uint8_t *)params->descr.data;
    descr.size = params->descr.size;
    dcp_result(out, vd_status(vd_create(user, (uint8_t)params->var_id, params->rep_cnt, descr, params->value,
                                        (uint16_t)params->timeout, clock_of(out))));
}

static void rtdb_update(void *user, const dcp_update_params_t *params, dcp_out_t *out)
{
    if (is_variable(out, params->var_id))
        dcp_result(out, vd_status(vd_update(user, (uint8_t)params->var_id, params->value, clock_of(out))));
}

static void rtdb_delete(void *user, const dcp_for_variable_params_t *params, dcp_out_t *out)
{
    if (is_variable(out, params->var_id))
        dcp_result(out, vd_status(vd_delete(user, (uint8_t)params->var_id, clock_of(out))));
}

static void rtdb_read(void *user, const dcp_for_variable_params_t *params, dcp_out_t *out)
{
    const variable_t *variable;
    vd_status_t status;
    if (!is_variable(out, params->var_id))
        return;
    status = vd_read(user, (uint8_t)params->var_id, &variable);
    dcp_result(out, vd_status(status));
    if (status == VD_OK) {
        dcp_put_octets_hex(out, "value", variable->record.upd.value.data, variable->record.upd.value.size);
        dcp_put_integer(out, "tStamp", variable->changed.wall);
    }
}

static void vd_mgmt_activate(void *user, dcp_out_t *out)
{
    node_t *const node = user;
    node->vd_active = true;
    dcp_result(out, DCP_VARDIS_STATUS_OK);
}

static void vd_mgmt_deactivate(void *user, dcp_out_t *out)
{
    node_t *const node = user;
    node->vd_active = false;
    dcp_result(out, DCP_VARDIS_STATUS_OK);
}

const dcp_methods_t methods = {
    .ut_hello = ut_hello,
    .ut_reset = ut_reset,
    .ut_subscribe = ut_subscribe,
    .bp_register_protocol = bp_register_protocol,
    .bp_deregister_protocol = bp_deregister_protocol,
    .bp_list_registered_protocols = bp_list_registered_protocols,
    .bp_transmit_payload = bp_transmit_payload,
    .bp_clear_buffer = bp_clear_buffer,
    .bp_query_number_buffered_payloads = bp_query_number_buffered_payloads,
    .bp_mgmt_activate = bp_mgmt_activate,
    .bp_mgmt_deactivate = bp_mgmt_deactivate,
    .bp_get_parameters = bp_get_parameters,
    .bp_set_parameter = bp_set_parameter,
    .srp_update_safety_data = srp_update_safety_data,
    .srp_neighbour_table = srp_neighbour_table,
    .srp_get_parameters = srp_get_parameters,
    .srp_set_parameter = srp_set_parameter,
    .rtdb_describe_database = rtdb_describe_database,
    .rtdb_describe_variable = rtdb_describe_variable,
    .rtdb_create = rtdb_create,
    .rtdb_update = rtdb_update,
    .rtdb_delete = rtdb_delete,
    .rtdb_read = rtdb_read,
    .vd_mgmt_activate = vd_mgmt_activate,
    .vd_mgmt_deactivate = vd_mgmt_deactivate,
    .vd_get_parameters = vd_get_parameters,
    .vd_set_parameter = vd_set_parameter,
};
