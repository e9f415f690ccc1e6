/* The octets that are being read: at is the next one, end the first one that may not be read. */
typedef struct reader {
    const uint8_t *octets;
    size_t at;
    size_t end;
    dcp_problem_t *problem;
} reader_t;

/* A scalar of a run, for the problem of a run that does not fit. */
typedef struct field {
    const char *name;
    uint8_t size;
    bool little;
    dcp_requirement_t requirement;
    dcp_reason_t rule;              /* DCP_OK: any value will do */
    dcp_requirement_t rule_requirement;
    uint64_t expected;              /* 0: any value but 0 */
} field_t;

static void report(reader_t *r, dcp_reason_t reason, dcp_requirement_t requirement, const char *field, size_t offset,
                   uint64_t needed, uint64_t available)
{
    r->problem->reason = reason;
    r->problem->requirement = requirement;
    r->problem->offset = offset;
    r->problem->needed = needed;
    r->problem->available = available;
    r->problem->field = field;
}

/* Always false, and every compiler can see that. */
static inline bool fail(reader_t *r, dcp_reason_t reason, dcp_requirement_t requirement, const char *field,
                        size_t offset, uint64_t needed, uint64_t available)
{
    report(r, reason, requirement, field, offset, needed, available);
    return false;
}

/* Report the first problem of a run that does not fit: a field that is cut off, or a wrong value before it. */
static void report_cut_off(reader_t *r, const field_t *fields, size_t count)
{
    size_t i, k;
    for (i = 0; i < count; i++) {
        const field_t *f = &fields[i];
        const uint64_t expected = f->expected != 0 ? f->expected : 1u;
        uint64_t value = 0;
        if (r->end - r->at < f->size) {
            report(r, DCP_TRUNCATED, f->requirement, f->name, r->at, f->size, r->end - r->at);
            return;
        }
        for (k = 0; f->rule != DCP_OK && k < f->size; k++)
            value = value << 8 | r->octets[r->at + (f->little ? f->size - 1u - k : k)];
        if (f->rule != DCP_OK && (f->expected != 0 ? value != f->expected : value == 0)) {
            report(r, f->rule, f->rule_requirement, f->name, r->at, expected, value);
            return;
        }
        r->at += f->size;
    }
}

static inline bool cut_off(reader_t *r, const field_t *fields, size_t count)
{
    report_cut_off(r, fields, count);
    return false;
}

static inline void begin(reader_t *r, const uint8_t *octets, size_t size, dcp_problem_t *problem)
{
    r->octets = octets;
    r->at = 0;
    r->end = size;
    r->problem = problem;
    problem->reason = DCP_OK;
}

static inline void resume(reader_t *r, const dcp_list_t *list, dcp_problem_t *problem)
{
    begin(r, list->octets, list->end, problem);
    r->at = list->at <= list->end ? list->at : list->end;
}
