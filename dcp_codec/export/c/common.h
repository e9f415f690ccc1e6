/* Why octets are not a beacon: the reasons of the test kit, by the same names. */
typedef enum dcp_reason {
@REASONS@
} dcp_reason_t;

/* The requirements that wrong octets break, by their identifiers in the test kit. */
typedef enum dcp_requirement {
@REQUIREMENTS@
} dcp_requirement_t;

/* A problem in octets; with reason DCP_OK there is none, and nothing else is set. The meaning of needed and available depends on the reason:
 * octets, or the number that should be there and the one that was found. */
typedef struct dcp_problem {
    dcp_reason_t reason;
    dcp_requirement_t requirement;
    size_t offset;      /* octet at which the field begins, counted from the first octet given */
    uint64_t needed;    /* 0 if there is nothing to tell */
    uint64_t available; /* 0 if there is nothing to tell */
    const char *field;  /* its name in the specification, with those of the records around it */
} dcp_problem_t;

/* Octets inside the input, or those to encode. They are not copied: the input must outlive them. */
typedef struct dcp_octets {
    const uint8_t *data;
    size_t size;
} dcp_octets_t;

/* Elements that are still to be read: payloads, containers or records. Its members are for the functions below. */
typedef struct dcp_list {
    const uint8_t *octets; /* the input */
    size_t at;             /* the next element */
    size_t end;            /* the first octet that does not belong to the list */
    size_t count_at;       /* the field that announces the number of elements */
    uint32_t count;        /* that number */
    uint32_t taken;        /* elements already read */
} dcp_list_t;

/* Why a value cannot be encoded, or the functions were called in a wrong order. */
typedef enum dcp_fault {
    DCP_FAULT_NONE,
    DCP_FAULT_NO_ROOM,      /* the buffer is full */
    DCP_FAULT_OUT_OF_RANGE, /* a number needs more octets than its field has */
    DCP_FAULT_TOO_LONG,     /* a text or a part is longer than its length can express */
    DCP_FAULT_NUL,          /* a text that ends with a NUL octet contains one */
    DCP_FAULT_TOO_MANY,     /* there are more elements than their count can express */
    DCP_FAULT_EMPTY,        /* a list that must not be empty is empty */
    DCP_FAULT_UNKNOWN_TYPE, /* the profile has no container of this type */
    DCP_FAULT_ORDER         /* a part was ended that was not begun, or begun twice */
} dcp_fault_t;

/* Writes into a buffer of the caller. A function that returns false has not changed the octets written so far; fault
 * says why. Lengths and counts are set when a part is ended. */
typedef struct dcp_writer {
    uint8_t *octets;
    size_t size;
    size_t at; /* octets written */
    dcp_fault_t fault;
    /* Places in parts that are not yet ended, and the numbers of their elements; DCP_NOWHERE: there is none. */
    size_t beacon, payloads, beacon_length, num_payloads;
    size_t payload, content, payload_length;
    size_t container, records, num_records, list_length;
    uint32_t payloads_written, records_written;
    uint64_t ic_type;
} dcp_writer_t;

#define DCP_NOWHERE SIZE_MAX
