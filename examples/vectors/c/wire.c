/* Runs the wire vectors of a profile, the lines of wire.txt, with the codec of that profile.
 *
 * With a codec of your own write its dcp_check_beacon, show_values and encode_values. */
#include "show_values.h"

#include <stdlib.h>

#define MAX_LINE 200000

static unsigned failed;

static void fail(const char *id, const char *what, const char *expected, const char *found)
{
    if (++failed <= 20u)
        printf("FAIL %s\n  %s: expected %s\n  %s  found    %s\n", id, what, expected, what, found);
}

static size_t from_hex(const char *text, uint8_t *octets)
{
    size_t size = 0;
    unsigned octet;
    for (; text[0] != '\0' && text[0] != '-' && sscanf(text, "%2x", &octet) == 1; text += 2)
        octets[size++] = (uint8_t)octet;
    return size;
}

/* Octets that are a beacon: their number, the values, and the same octets from the values. */
static void run_valid(char **field, const uint8_t *octets, size_t size)
{
    static text_t text;
    static uint8_t again[65536];
    dcp_problem_t problem;
    dcp_writer_t writer;
    char number[32];
    if (!dcp_check_beacon(octets, size, &problem)) {
        fail(field[1], "reason", "none", dcp_reason_name(problem.reason));
        return;
    }
    (void)snprintf(number, sizeof number, "%lu", (unsigned long)problem.offset);
    if (strcmp(number, field[3]) != 0)
        fail(field[1], "size", field[3], number);
    text.size = 0;
    show_values(&text, octets, size);
    if (strcmp(text.data, field[5]) != 0)
        fail(field[1], "values", field[5], text.data);
    dcp_write_to(&writer, again, sizeof again);
    if (strcmp(field[4], "both") == 0
        && (!encode_values(&writer, octets, size) || writer.at != size || memcmp(again, octets, size) != 0))
        fail(field[1], "encoding", field[2], "other octets");
}

/* Octets that are not a beacon: why, and where. */
static void run_invalid(char **field, const uint8_t *octets, size_t size)
{
    dcp_problem_t problem;
    char number[32];
    const char *name;
    if (dcp_check_beacon(octets, size, &problem)) {
        fail(field[1], "reason", field[3], "none");
        return;
    }
    if (strcmp(dcp_reason_name(problem.reason), field[3]) != 0)
        fail(field[1], "reason", field[3], dcp_reason_name(problem.reason));
    (void)snprintf(number, sizeof number, "%lu", (unsigned long)problem.offset);
    if (strcmp(number, field[4]) != 0)
        fail(field[1], "offset", field[4], number);
    name = dcp_requirement_name(problem.requirement);
    if (strcmp(name[0] != '\0' ? name : "-", field[5]) != 0)
        fail(field[1], "requirement", field[5], name);
    if (strcmp(problem.field[0] != '\0' ? problem.field : "-", field[6]) != 0)
        fail(field[1], "field", field[6], problem.field);
    (void)snprintf(number, sizeof number, "%lu", (unsigned long)problem.needed);
    if (strcmp(number, field[7]) != 0)
        fail(field[1], "needed", field[7], number);
    (void)snprintf(number, sizeof number, "%lu", (unsigned long)problem.available);
    if (strcmp(number, field[8]) != 0)
        fail(field[1], "available", field[8], number);
}

int main(int argc, char **argv)
{
    static char line[MAX_LINE];
    static uint8_t octets[MAX_LINE / 2];
    unsigned count = 0;
    FILE *file;
    if (argc != 2 || (file = fopen(argv[1], "r")) == NULL) {
        (void)fputs("usage: wire wire.txt\n", stderr);
        return 2;
    }
    while (fgets(line, sizeof line, file) != NULL) {
        char *field[9] = {line};
        int n;
        line[strcspn(line, "\n")] = '\0';
        for (n = 1; n < 9 && (field[n] = strchr(field[n - 1], '\t')) != NULL; n++)
            *field[n]++ = '\0';
        if (line[0] != '#') {
            /* A copy of exactly this size, so that a sanitizer notices a read behind it. */
            const size_t size = from_hex(field[2], octets);
            uint8_t *const exact = malloc(size != 0 ? size : 1u);
            if (exact == NULL)
                return 2;
            memcpy(exact, octets, size);
            (line[0] == 'V' ? run_valid : run_invalid)(field, exact, size);
            free(exact);
            count++;
        }
    }
    (void)fclose(file);
    printf("%u vectors, %u failed\n", count, failed);
    return failed != 0 || count == 0;
}
