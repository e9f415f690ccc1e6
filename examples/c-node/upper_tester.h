/* The services of the node for the upper tester: one function for each method of the contract. */
#ifndef UPPER_TESTER_H
#define UPPER_TESTER_H

#include "dcp_adapter.h"
#include "node.h"

#define MAX_SUBSCRIPTIONS 64u

/* What a client of the control socket wants to be notified of. */
typedef struct subscription {
    bool variables, neighbours;
    int64_t prot_ids[MAX_SUBSCRIPTIONS];
    size_t count;
} subscription_t;

/* Who sends the request that is being handled: user of dcp_out_t leads to it. */
typedef struct session {
    int number;
    subscription_t subscription;
    node_time_t (*clock)(void);
    void (*registered)(int number, uint16_t protocol_id); /* this session gets the indications of the protocol */
} session_t;

extern const dcp_methods_t methods;

#endif
