/* Replay of behaviour vectors without network or threads: what a runner calls, and what is written for each node. */
#ifndef VECTOR_H
#define VECTOR_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Of vector.c. Give it each line of behaviour.txt (which it changes), and call vector_end before the next T and after the
 * last line. */
void vector_line(char *line);
void vector_end(void);
/* Something came out of the node: kind and number as README.md of the vectors has them. */
void vector_note(double ms, const char *kind, unsigned number, const uint8_t *octets, size_t size);

/* Of the runner: something is wrong. */
void vector_failed(const char *what, const char *expected, const char *found);

/* Of the node: sut.c has those of examples/c-node. Times are milliseconds since the start. */
void sut_start(const uint8_t *node_id, int64_t wall_clock); /* a new node; wall clock in ns since 1970 */
void sut_receive(const uint8_t *octets, size_t size);
const char *sut_call(char *request); /* a request of the upper tester, which it may change; returns the answer (JSON) */
void sut_advance(int64_t ms); /* set the clock, and do what is due until then */

#ifdef __cplusplus
}
#endif

#endif
