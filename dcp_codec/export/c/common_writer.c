static bool put_octets(dcp_writer_t *w, dcp_octets_t octets)
{
    if (w->size - w->at < octets.size)
        return dcp_refuse(w, DCP_FAULT_NO_ROOM);
    dcp_copy(w->octets + w->at, octets.data, octets.size);
    w->at += octets.size;
    return true;
}

void dcp_write_to(dcp_writer_t *w, uint8_t *octets, size_t size)
{
    w->octets = octets;
    w->size = size;
    w->at = 0;
    w->fault = DCP_FAULT_NONE;
    w->beacon = w->payloads = w->beacon_length = w->num_payloads = DCP_NOWHERE;
    w->payload = w->content = w->payload_length = DCP_NOWHERE;
    w->container = w->records = w->num_records = w->list_length = DCP_NOWHERE;
    w->payloads_written = w->records_written = 0;
    w->ic_type = 0;
}
