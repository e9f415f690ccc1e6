/* Runs all vectors of a file, and prints those that fail. */
#include "vector.h"

#include <stdio.h>

#define MAX_LINE 400000

static char test[200];
static bool bad; /* the present vector has failed */
static unsigned failed;

void vector_failed(const char *what, const char *expected, const char *found)
{
    if (!bad && ++failed <= 60u)
        printf("FAIL %s\n  %s\n  expected %s\n  found    %s\n", test, what, expected, found);
    bad = true;
}

int main(int argc, char **argv)
{
    static char line[MAX_LINE];
    unsigned count = 0;
    FILE *file;
    if (argc != 2 || (file = fopen(argv[1], "r")) == NULL) {
        (void)fputs("usage: behaviour behaviour.txt\n", stderr);
        return 2;
    }
    while (fgets(line, sizeof line, file) != NULL) {
        if (line[0] == 'T') {
            vector_end();
            (void)sscanf(line, "T %199s", test);
            bad = false;
            count++;
        }
        vector_line(line);
    }
    vector_end();
    (void)fclose(file);
    printf("%u vectors, %u failed\n", count, failed);
    return failed != 0 || count == 0;
}
