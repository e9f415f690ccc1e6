#ifdef __cplusplus
#define DCP_RESTRICT
#else
#define DCP_RESTRICT restrict
#endif

static inline bool dcp_refuse(dcp_writer_t *w, dcp_fault_t fault)
{
    w->fault = fault;
    return false;
}

/* Copy octets, which must not overlap; without data: zeros. */
static inline void dcp_copy(uint8_t *DCP_RESTRICT to, const uint8_t *DCP_RESTRICT data, size_t size)
{
    size_t i;
    if (data != NULL)
        for (i = 0; i < size; i++)
            to[i] = data[i];
    else
        for (i = 0; i < size; i++)
            to[i] = 0;
}
