/* Replays behaviour vectors, the lines of behaviour.txt, and judges what comes out of the node. */
#include "vector.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MAX_EVENTS 20000
#define MAX_OCTETS 3100
#define MAX_FRAME 65536

/* Something that came out of the node. */
typedef struct event {
    double time;
    char kind[12];
    unsigned number;
    char octets[MAX_OCTETS];
    bool expected;
} event_t;

static event_t events[MAX_EVENTS];
static size_t event_count;
static const char *answer = "";
static uint8_t node_id[16];
static int64_t wall_clock; /* at the start, ns since 1970 */
static int64_t end;
static bool ended = true;

static void to_hex(char *text, const uint8_t *octets, size_t size)
{
    size_t i;
    for (i = 0; i < size && 2u * i + 3u < MAX_OCTETS; i++)
        (void)snprintf(text + 2u * i, 3, "%02x", octets[i]);
    text[2u * i] = '\0';
}

void vector_note(double ms, const char *kind, unsigned number, const uint8_t *octets, size_t size)
{
    event_t *const event = &events[event_count];
    if (event_count == MAX_EVENTS)
        return;
    event_count++;
    event->time = ms;
    (void)snprintf(event->kind, sizeof event->kind, "%s", kind);
    event->number = number;
    event->expected = false;
    to_hex(event->octets, octets, size);
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
            vector_failed(path, expected, answer);
        return;
    }
    if (value == NULL) /* an implementation does not show every member */
        return;
    (void)snprintf(found, sizeof found, "%.*s", (int)(behind(value) - value), value);
    if (strcmp(found, expected) != 0 && (strtod(found, NULL) != strtod(expected, NULL) || *expected == '"'))
        vector_failed(path, expected, answer);
}

static void check_status(const char *allowed)
{
    const char *const result = member(answer, "result", 6);
    const char *const status = result != NULL ? member(result, "status", 6) : NULL;
    char found[100];
    (void)snprintf(found, sizeof found, " %.*s ", status != NULL ? (int)(behind(status) - status) - 2 : 0,
                   status != NULL ? status + 1 : "");
    if (strcmp(allowed, "  ") != 0 && (status == NULL || strstr(allowed, found) == NULL))
        vector_failed("status", allowed, answer);
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
        vector_failed(what, text + 50, text);
    }
}

/* ---- lines ----------------------------------------------------------------------------------------------------------------- */

static size_t from_hex(const char *text, uint8_t *octets, size_t most)
{
    size_t size = 0;
    unsigned octet;
    for (; size < most && sscanf(text, "%2x", &octet) == 1; text += 2) {
        octets[size++] = (uint8_t)octet;
        if (text[1] == '\0')
            break;
    }
    return size;
}

void vector_line(char *line)
{
    static uint8_t octets[MAX_FRAME];
    char *field[8] = {line};
    int n;
    line[strcspn(line, "\n")] = '\0';
    for (n = 1; n < 8 && (field[n] = strchr(field[n - 1], '\t')) != NULL; n++)
        *field[n]++ = '\0';
    if (line[0] == 'E' && !ended) {
        sut_advance(end);
        ended = true;
    }
    switch (line[0]) {
    case 'N':
        (void)from_hex(field[1], node_id, sizeof node_id);
        wall_clock = strtoll(field[2], NULL, 10);
        break;
    case 'T':
        end = atol(field[2]);
        ended = false;
        event_count = 0;
        sut_start(node_id, wall_clock);
        break;
    case 'F':
        sut_advance(atol(field[1]));
        sut_receive(octets, from_hex(field[2], octets, sizeof octets));
        break;
    case 'C':
        sut_advance(atol(field[1]));
        answer = sut_call(field[3]);
        check_status(field[2]);
        break;
    case 'R':
        check(field[1], field[2]);
        break;
    case 'E':
        expect(field);
        break;
    default:
        break;
    }
}

void vector_end(void)
{
    char text[MAX_OCTETS + 100];
    size_t i;
    if (!ended)
        sut_advance(end);
    ended = true;
    for (i = 0; i < event_count; i++)
        if (!events[i].expected) {
            (void)snprintf(text, sizeof text, "%s %u %s at %.1f ms", events[i].kind, events[i].number, events[i].octets,
                           events[i].time);
            vector_failed("an event", "none", text);
        }
    event_count = 0;
}
