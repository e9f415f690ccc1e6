/* Feeds lines (length of 4 octets, little-endian, and octets) to the example node through the adapter; writes the answers
 * and an empty line after each. The clock stands still. */
#include "upper_tester.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static node_t node;

static void ignore_send(void *user, const uint8_t *beacon, size_t size) { (void)user; (void)beacon; (void)size; }
static void ignore_received(void *user, uint16_t id, const uint8_t *payload, size_t size, const uint8_t *sender)
{
    (void)user; (void)id; (void)payload; (void)size; (void)sender;
}
static void ignore_transmitted(void *user, uint16_t id, int64_t next) { (void)user; (void)id; (void)next; }
static void ignore_variable(void *user, variable_event_t event, const variable_t *variable)
{
    (void)user; (void)event; (void)variable;
}
static void ignore_seen(void *user, const uint8_t *id, bool is_new) { (void)user; (void)id; (void)is_new; }
static void ignore_expired(void *user, const uint8_t *id) { (void)user; (void)id; }

static const node_events_t events = {ignore_send,     ignore_received, ignore_transmitted,
                                     ignore_variable, ignore_seen,     ignore_expired};

static node_time_t standing(void)
{
    node_time_t t = {1000000000, INT64_C(1700000000000000000)};
    return t;
}

static void ignore_registration(int number, uint16_t id) { (void)number; (void)id; }

static void flush(dcp_out_t *out)
{
    fwrite(out->data, 1, out->at, stdout);
    out->at = 0;
}

int main(void)
{
    static const uint8_t id[NODE_ID_SIZE] = {2, 0, 0, 0, 0, 1};
    session_t session = {0};
    uint8_t head[4];
    session.clock = standing;
    session.registered = ignore_registration;
    node_init(&node, id, &events, NULL, standing());
    while (fread(head, 1, 4, stdin) == 4) {
        const size_t size = (size_t)head[0] | (size_t)head[1] << 8 | (size_t)head[2] << 16;
        char *line = malloc(size != 0 ? size : 1u), text[64];
        dcp_out_t out;
        if (line == NULL || fread(line, 1, size, stdin) != size)
            return 1;
        memset(&out, 0, sizeof out);
        out.data = text;
        out.size = sizeof text;
        out.flush = flush;
        out.user = &session;
        dcp_handle_line(&methods, &node, line, size, &out);
        putchar('\n');
        free(line);
    }
    return 0;
}
