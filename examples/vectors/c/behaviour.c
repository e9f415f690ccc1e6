/* Replays behaviour vectors, the lines of behaviour.txt, on the node of examples/c-node: no network, no threads.
 *
 * With a node of your own, write start, receive, call and advance below, and call note for what it sends and indicates. */
#include "upper_tester.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MAX_LINE 400000
#define MAX_EVENTS 20000
#define MAX_OCTETS 3100
#define MS 1000000

/* Something that came out of the node. */
typedef struct event {
    double time;
    char kind[12];
    unsigned number;
    char octets[MAX_OCTETS];
    bool expected;
} event_t;

static node_t node;
static node_time_t current;
static int64_t started; /* wall clock at the start, ns since 1970 */
static event_t events[MAX_EVENTS];
static size_t event_count;
static char test[200];
static bool bad; /* the present vector has failed */
static unsigned failed;
static char answer[200000];

static void fail(const char *what, const char *expected, const char *found)
{
    if (!bad && ++failed <= 60u)
        printf("FAIL %s\n  %s\n  expected %s\n  found    %s\n", test, what, expected, found);
    bad = true;
}

static void to_hex(char *text, const uint8_t *octets, size_t size)
{
    size_t i;
    for (i = 0; i < size && 2u * i + 3u < MAX_OCTETS; i++)
        (void)snprintf(text + 2u * i, 3, "%02x", octets[i]);
    text[2u * i] = '\0';
}

static void note(const char *kind, unsigned number, const uint8_t *octets, size_t size)
{
    event_t *const event = &events[event_count];
    if (event_count == MAX_EVENTS)
        return;
    event_count++;
    event->time = (double)current.now / MS;
    (void)snprintf(event->kind, sizeof event->kind, "%s", kind);
    event->number = number;
    event->expected = false;
    to_hex(event->octets, octets, size);
}

/* ---- the node ---------------------------------------------------------------------------------------------------------- */

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
        fail("containers", "good ones", dcp_reason_name(problem.reason));
}

static void sent(void *user, const uint8_t *octets, size_t size)
{
    dcp_beacon_t beacon;
    dcp_payload_t payload;
    dcp_problem_t problem;
    (void)user;
    if (!dcp_read_beacon(octets, size, &beacon, &problem)) {
        fail("beacon", "a good one", dcp_reason_name(problem.reason));
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

static void advance(int64_t ms)
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

static void start(const uint8_t *id)
{
    static bool before;
    current.now = 0;
    current.wall = started;
    if (before) /* frees what waits */
        node_reset(&node, current);
    before = true;
    node_init(&node, id, &callbacks, NULL, current);
    event_count = 0;
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

static void call(char *line)
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
    dcp_handle_line(&methods, &node, line, strlen(line), &out);
}

/* ---- JSON of an answer --------------------------------------------------------------------------------------------------- */

/* Return the end of a JSON value. */
static const char *behind(const char *p)
{
    int depth = 0;
    do {
        if (*p == '"')
            for (p++; *p != '\0' && *p != '"'; p++)
                if (*p == '\\')
                    p++;
        if (*p == '{' || *p == '[')
            depth++;
        if (*p == '}' || *p == ']')
            depth--;
        if (*p != '\0')
            p++;
    } while (*p != '\0' && (depth > 0 || strchr(",]}", *p) == NULL));
    return p;
}

/* Return the value of a member of an object; NULL if there is none. */
static const char *member(const char *object, const char *name, size_t size)
{
    const char *p = object;
    while (p != NULL && (*p == '{' || *p == ',') && p[1] == '"') {
        const char *const key = p + 2, *const colon = strchr(key, ':');
        if (colon == NULL)
            return NULL;
        if (strncmp(key, name, size) == 0 && key[size] == '"')
            return colon + 1;
        p = behind(colon + 1);
    }
    return NULL;
}

/* Return the row of a list that has an identifier: the first member that has this value. */
static const char *row(const char *list, const char *key, const char *id, size_t size)
{
    const char *p = list;
    while (p != NULL && (*p == '[' || *p == ',') && p[1] == '{') {
        const char *value = member(p + 1, key, strlen(key));
        if (value != NULL && *value == '"')
            value++;
        if (value != NULL && strncmp(value, id, size) == 0 && strchr(",}\"", value[size]) != NULL)
            return p + 1;
        p = behind(p + 1);
    }
    return NULL;
}

/* Check a member of the answer: number, variable.seqno, protocols[16385].maxEntries, variables[3]. */
static void check(const char *path, const char *expected)
{
    const char *value = member(answer, "result", 6), *p = path;
    char found[4000];
    while (value != NULL && *p != '\0') {
        const size_t size = strcspn(p, ".[");
        value = member(value, p, size);
        p += size;
        if (*p == '[') {
            const char *const key = strncmp(path, "protocols", 9) == 0    ? "protocolId"
                                    : strncmp(path, "neighbours", 10) == 0 ? "nodeId"
                                                                           : "varId";
            const size_t length = strcspn(p + 1, "]");
            if (value != NULL)
                value = row(value, key, p + 1, length);
            p += length + 2u;
        }
        if (*p == '.')
            p++;
    }
    if (path[strlen(path) - 1u] == ']') { /* a row, which is there or not */
        if ((value != NULL) != (strcmp(expected, "true") == 0))
            fail(path, expected, answer);
        return;
    }
    if (value == NULL) /* an implementation does not show every member */
        return;
    (void)snprintf(found, sizeof found, "%.*s", (int)(behind(value) - value), value);
    if (strcmp(found, expected) != 0 && (strtod(found, NULL) != strtod(expected, NULL) || *expected == '"'))
        fail(path, expected, answer);
}

static void check_status(const char *allowed)
{
    const char *const result = member(answer, "result", 6);
    const char *const status = result != NULL ? member(result, "status", 6) : NULL;
    char found[100];
    (void)snprintf(found, sizeof found, " %.*s ", status != NULL ? (int)(behind(status) - status) - 2 : 0,
                   status != NULL ? status + 1 : "");
    if (strcmp(allowed, "  ") != 0 && (status == NULL || strstr(allowed, found) == NULL))
        fail("status", allowed, answer);
}

/* ---- events ---------------------------------------------------------------------------------------------------------------- */

static bool matches(const char *pattern, const char *octets)
{
    for (; *pattern != '\0' && *octets != '\0'; pattern++, octets++)
        if (*pattern != '?' && *pattern != *octets)
            return false;
    return *pattern == *octets;
}

static void expect(char **field)
{
    const char *const octets = strcmp(field[3], "-") == 0 ? "" : field[3];
    const double after = atof(field[4]), before = atof(field[5]);
    char text[100];
    long count = 0;
    size_t i;
    for (i = 0; i < event_count; i++) {
        event_t *const event = &events[i];
        if (!event->expected && strcmp(event->kind, field[1]) == 0 && event->number == (unsigned)atol(field[2])
            && event->time >= after && event->time <= before && matches(octets, event->octets)) {
            event->expected = true;
            count++;
        }
    }
    (void)snprintf(text, sizeof text, "%ld times", count);
    if (count < atol(field[6]) || (strcmp(field[7], "-") != 0 && count > atol(field[7]))) {
        char what[MAX_OCTETS + 200];
        (void)snprintf(what, sizeof what, "%s %s %s from %s to %s ms", field[1], field[2], field[3], field[4], field[5]);
        (void)snprintf(text + 50, 50, "%s to %s times", field[6], field[7]);
        fail(what, text + 50, text);
    }
}

static void nothing_else(void)
{
    char text[MAX_OCTETS + 100];
    size_t i;
    for (i = 0; i < event_count; i++)
        if (!events[i].expected) {
            (void)snprintf(text, sizeof text, "%s %u %s at %.1f ms", events[i].kind, events[i].number, events[i].octets,
                           events[i].time);
            fail("an event", "none", text);
        }
    event_count = 0;
}

/* ---- lines ----------------------------------------------------------------------------------------------------------------- */

static size_t from_hex(const char *text, uint8_t *octets)
{
    size_t size = 0;
    unsigned octet;
    for (; *text != '\0' && sscanf(text, "%2x", &octet) == 1; text += 2)
        octets[size++] = (uint8_t)octet;
    return size;
}

int main(int argc, char **argv)
{
    static char line[MAX_LINE];
    static uint8_t octets[MAX_LINE / 2];
    uint8_t id[NODE_ID_SIZE];
    unsigned count = 0;
    int64_t end = 0;
    bool ended = true;
    FILE *file;
    if (argc != 2 || (file = fopen(argv[1], "r")) == NULL) {
        (void)fputs("usage: behaviour behaviour.txt\n", stderr);
        return 2;
    }
    while (fgets(line, sizeof line, file) != NULL) {
        char *field[8] = {line};
        int n;
        line[strcspn(line, "\n")] = '\0';
        for (n = 1; n < 8 && (field[n] = strchr(field[n - 1], '\t')) != NULL; n++)
            *field[n]++ = '\0';
        if (line[0] == 'E' && !ended) {
            advance(end);
            ended = true;
        }
        switch (line[0]) {
        case 'N':
            (void)from_hex(field[1], id);
            started = strtoll(field[2], NULL, 10);
            break;
        case 'T':
            nothing_else();
            (void)snprintf(test, sizeof test, "%s", field[1]);
            bad = ended = false;
            end = atol(field[2]);
            count++;
            start(id);
            break;
        case 'F':
            advance(atol(field[1]));
            node_receive(&node, octets, from_hex(field[2], octets), current);
            break;
        case 'C':
            advance(atol(field[1]));
            call(field[3]);
            check_status(field[2]);
            break;
        case 'R':
            check(field[1], field[2]);
            break;
        case 'E':
            expect(field + 0);
            break;
        default:
            break;
        }
    }
    nothing_else();
    node_reset(&node, current);
    (void)fclose(file);
    printf("%u vectors, %u failed\n", count, failed);
    return failed != 0 || count == 0;
}
