static bool read_real(slice_t value, double *real)
{
    dcp_number_t number;
    if (first_of(value) == '"') {
        const dcp_text_t text = decode(value);
        const double zero = 0.0;
        if (is(text, "NaN"))
            *real = zero / zero;
        else if (is(text, "Infinity"))
            *real = 1.0 / zero;
        else if (is(text, "-Infinity"))
            *real = -1.0 / zero;
        else
            return false;
        return true;
    }
    if (!read_number(value, &number))
        return false;
    *real = number.real;
    return true;
}
