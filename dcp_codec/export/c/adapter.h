/* Text in UTF-8; not ended by a NUL. */
typedef struct dcp_text {
    const char *data;
    size_t size;
} dcp_text_t;

/* A number of JSON: an integer, or with is_integer false a real number. */
typedef struct dcp_number {
    bool is_integer;
    int64_t integer;
    double real; /* also set for an integer */
} dcp_number_t;

/* Output: JSON is written to data, and handed to flush when data is full and after each line. */
typedef struct dcp_out {
    char *data;
    size_t size;
    size_t at;
    void (*flush)(struct dcp_out *out); /* has to set at to 0 */
    void *user;                         /* for flush and the methods: who is served */
    /* The rest is for the functions below: set it to zero. */
    dcp_text_t id; /* of the request, as JSON */
    char before;   /* precedes the next message */
    bool comma;    /* a member or element precedes in this object or list */
    bool open;     /* the answer is begun */
    bool muted;    /* the request wants no answer */
} dcp_out_t;

/* Errors of the contract. */
#define DCP_ERROR_PARSE (-32700)
#define DCP_ERROR_INVALID_REQUEST (-32600)
#define DCP_ERROR_NO_METHOD (-32601)
#define DCP_ERROR_INVALID_PARAMS (-32602)
#define DCP_ERROR_INTERNAL (-32603)
#define DCP_ERROR_BAD_VALUE (-32001)
#define DCP_ERROR_NO_ANSWER (-32002)
#define DCP_ERROR_NOT_REACHED (-32003)

#define DCP_MAX_BATCH 256

@TYPES@

/* Handle one line, without its end; its octets are changed. Calls at most one function for each request in it, and
 * writes the answers as one line. Lines without content and requests without id have no answer. */
void dcp_handle_line(const dcp_methods_t *methods, void *node, char *line, size_t size, dcp_out_t *out);

/* Answer a line that is longer than the buffer of the caller. */
void dcp_line_too_long(dcp_out_t *out);

/* For the methods. Begin a result with its status, then add members; or write an error instead. A method that calls
 * none of them causes an internal error. */
void dcp_result(dcp_out_t *out, dcp_status_t status);
void dcp_error(dcp_out_t *out, int code, const char *message);
const char *dcp_status_name(dcp_status_t status);

/* Add a member to a result, or with name NULL an element to a list. */
void dcp_put_integer(dcp_out_t *out, const char *name, int64_t value);
void dcp_put_unsigned(dcp_out_t *out, const char *name, uint64_t value);
void dcp_put_real(dcp_out_t *out, const char *name, double value);
void dcp_put_boolean(dcp_out_t *out, const char *name, bool value);
void dcp_put_text(dcp_out_t *out, const char *name, const char *text);
void dcp_put_octets_hex(dcp_out_t *out, const char *name, const uint8_t *data, size_t size);
void dcp_put_node_id(dcp_out_t *out, const char *name, const uint8_t *data, size_t size);
/* A description: as descr, or as descrHex if it is not UTF-8. */
void dcp_put_description(dcp_out_t *out, const uint8_t *data, size_t size);
@SAFETY_DECLARATION@
/* The methods that are not NULL, for UT-Hello. */
void dcp_put_methods(dcp_out_t *out, const char *name, const dcp_methods_t *methods);
void dcp_begin_object(dcp_out_t *out, const char *name);
void dcp_end_object(dcp_out_t *out);
void dcp_begin_list(dcp_out_t *out, const char *name);
void dcp_end_list(dcp_out_t *out);

/* Read a list of integers. False: there is no further one. */
bool dcp_next_integer(dcp_text_t *list, int64_t *value);

/* Write a notification as one line. */
@NOTIFICATION_DECLARATIONS@
