/* ---- output ---------------------------------------------------------------------------------------------------- */

static void put(dcp_out_t *out, char c)
{
    if (out->muted)
        return;
    if (out->at == out->size)
        out->flush(out);
    if (out->at < out->size)
        out->data[out->at++] = c;
}

static void put_string(dcp_out_t *out, const char *text)
{
    while (*text != '\0')
        put(out, *text++);
}

static void put_raw(dcp_out_t *out, dcp_text_t text)
{
    size_t i;
    for (i = 0; i < text.size; i++)
        put(out, text.data[i]);
}

static void put_hex(dcp_out_t *out, unsigned octet)
{
    put(out, "0123456789abcdef"[octet >> 4 & 15u]);
    put(out, "0123456789abcdef"[octet & 15u]);
}

/* Text in quotation marks; it is valid UTF-8. */
static void put_quoted(dcp_out_t *out, const char *data, size_t size)
{
    size_t i;
    put(out, '"');
    for (i = 0; i < size; i++) {
        const unsigned char c = (unsigned char)data[i];
        if (c == '"' || c == '\\') {
            put(out, '\\');
            put(out, (char)c);
        } else if (c < 0x20u || c == 0x7Fu) {
            put_string(out, "\\u00");
            put_hex(out, c);
        } else {
            put(out, (char)c);
        }
    }
    put(out, '"');
}

static void put_name(dcp_out_t *out, const char *name)
{
    if (out->comma)
        put(out, ',');
    out->comma = true;
    if (name != NULL) {
        put_quoted(out, name, strlen(name));
        put(out, ':');
    }
}

void dcp_put_unsigned(dcp_out_t *out, const char *name, uint64_t value)
{
    char digits[20];
    size_t count = 0;
    put_name(out, name);
    do {
        digits[count++] = (char)('0' + (char)(value % 10u));
        value /= 10u;
    } while (value != 0);
    while (count != 0)
        put(out, digits[--count]);
}

void dcp_put_integer(dcp_out_t *out, const char *name, int64_t value)
{
    if (value >= 0) {
        dcp_put_unsigned(out, name, (uint64_t)value);
        return;
    }
    put_name(out, name);
    put(out, '-');
    out->comma = false;
    dcp_put_unsigned(out, NULL, (uint64_t)-(value + 1) + 1u);
}

void dcp_put_real(dcp_out_t *out, const char *name, double value)
{
    char text[40];
    if (value != value) {
        dcp_put_text(out, name, "NaN");
    } else if (value - value != 0.0) {
        dcp_put_text(out, name, value > 0.0 ? "Infinity" : "-Infinity");
    } else {
        put_name(out, name);
        (void)snprintf(text, sizeof text, "%.17g", value);
        put_string(out, text);
    }
}

void dcp_put_boolean(dcp_out_t *out, const char *name, bool value)
{
    put_name(out, name);
    put_string(out, value ? "true" : "false");
}

void dcp_put_text(dcp_out_t *out, const char *name, const char *text)
{
    put_name(out, name);
    put_quoted(out, text, strlen(text));
}

void dcp_put_octets_hex(dcp_out_t *out, const char *name, const uint8_t *data, size_t size)
{
    size_t i;
    put_name(out, name);
    put(out, '"');
    for (i = 0; i < size; i++)
        put_hex(out, data[i]);
    put(out, '"');
}

void dcp_put_node_id(dcp_out_t *out, const char *name, const uint8_t *data, size_t size)
{
    size_t i;
    put_name(out, name);
    put(out, '"');
    for (i = 0; i < size; i++) {
        if (i != 0)
            put(out, ':');
        put_hex(out, data[i]);
    }
    put(out, '"');
}

void dcp_begin_object(dcp_out_t *out, const char *name)
{
    put_name(out, name);
    put(out, '{');
    out->comma = false;
}

void dcp_end_object(dcp_out_t *out)
{
    put(out, '}');
    out->comma = true;
}

void dcp_begin_list(dcp_out_t *out, const char *name)
{
    put_name(out, name);
    put(out, '[');
    out->comma = false;
}

void dcp_end_list(dcp_out_t *out)
{
    put(out, ']');
    out->comma = true;
}

static void end_line(dcp_out_t *out)
{
    put(out, '\n');
    out->flush(out);
}

/* ---- reading JSON ------------------------------------------------------------------------------------------------ */

#define MAX_DEPTH 32u

/* A position in JSON that is known to be valid. */
typedef struct cursor {
    char *at;
    char *end;
} cursor_t;

static void skip_space(cursor_t *c)
{
    while (c->at != c->end && (*c->at == ' ' || *c->at == '\t' || *c->at == '\r' || *c->at == '\n'))
        c->at++;
}

/* Octets of the UTF-8 sequence at data; 0: it is not valid. */
static size_t utf8(const unsigned char *data, size_t size)
{
    const unsigned first = data[0];
    size_t count, i;
    if (first < 0x80u)
        return 1;
    count = first >= 0xC2u && first < 0xE0u ? 2u : first >= 0xE0u && first < 0xF0u ? 3u
          : first >= 0xF0u && first < 0xF5u ? 4u : 0u;
    if (count == 0 || count > size)
        return 0;
    for (i = 1; i < count; i++)
        if ((data[i] & 0xC0u) != 0x80u)
            return 0;
    if ((first == 0xE0u && data[1] < 0xA0u) || (first == 0xEDu && data[1] > 0x9Fu)
        || (first == 0xF0u && data[1] < 0x90u) || (first == 0xF4u && data[1] > 0x8Fu))
        return 0;
    return count;
}

void dcp_put_description(dcp_out_t *out, const uint8_t *data, size_t size)
{
    size_t i = 0;
    while (i < size) {
        const size_t count = utf8(data + i, size - i);
        if (count == 0) {
            dcp_put_octets_hex(out, "descrHex", data, size);
            return;
        }
        i += count;
    }
    put_name(out, "descr");
    put_quoted(out, (const char *)data, size);
}

static int hex_digit(char c)
{
    if (c >= '0' && c <= '9')
        return c - '0';
    if (c >= 'a' && c <= 'f')
        return c - 'a' + 10;
    if (c >= 'A' && c <= 'F')
        return c - 'A' + 10;
    return -1;
}

/* Four hexadecimal digits; -1: they are not. */
static long hex4(const char *at)
{
    long value = 0;
    int i;
    for (i = 0; i < 4; i++) {
        const int digit = hex_digit(at[i]);
        if (digit < 0)
            return -1;
        value = value * 16 + digit;
    }
    return value;
}

static bool check_string(cursor_t *c)
{
    c->at++;
    while (c->at != c->end) {
        const unsigned char octet = (unsigned char)*c->at;
        if (octet == '"') {
            c->at++;
            return true;
        }
        if (octet < 0x20u)
            return false;
        if (octet == '\\') {
            long unit;
            if (c->end - c->at < 2)
                return false;
            c->at++;
            if (*c->at != 'u') {
                if (strchr("\"\\/bfnrt", *c->at) == NULL || *c->at == '\0')
                    return false;
                c->at++;
                continue;
            }
            if (c->end - c->at < 5 || (unit = hex4(c->at + 1)) < 0)
                return false;
            c->at += 5;
            if (unit >= 0xDC00 && unit < 0xE000)
                return false;
            if (unit >= 0xD800 && unit < 0xDC00) {
                if (c->end - c->at < 6 || c->at[0] != '\\' || c->at[1] != 'u')
                    return false;
                unit = hex4(c->at + 2);
                if (unit < 0xDC00 || unit >= 0xE000)
                    return false;
                c->at += 6;
            }
        } else {
            const size_t count = utf8((const unsigned char *)c->at, (size_t)(c->end - c->at));
            if (count == 0)
                return false;
            c->at += count;
        }
    }
    return false;
}

static bool digits(cursor_t *c)
{
    const char *begin = c->at;
    while (c->at != c->end && *c->at >= '0' && *c->at <= '9')
        c->at++;
    return c->at != begin;
}

static bool check_number(cursor_t *c)
{
    if (*c->at == '-')
        c->at++;
    if (c->at != c->end && *c->at == '0')
        c->at++;
    else if (!digits(c))
        return false;
    if (c->at != c->end && *c->at == '.') {
        c->at++;
        if (!digits(c))
            return false;
    }
    if (c->at != c->end && (*c->at == 'e' || *c->at == 'E')) {
        c->at++;
        if (c->at != c->end && (*c->at == '+' || *c->at == '-'))
            c->at++;
        return digits(c);
    }
    return true;
}

static bool check_word(cursor_t *c, const char *word)
{
    const size_t size = strlen(word);
    if ((size_t)(c->end - c->at) < size || memcmp(c->at, word, size) != 0)
        return false;
    c->at += size;
    return true;
}

static bool check_name(cursor_t *c)
{
    skip_space(c);
    if (c->at == c->end || *c->at != '"' || !check_string(c))
        return false;
    skip_space(c);
    if (c->at == c->end || *c->at != ':')
        return false;
    c->at++;
    return true;
}

/* Move past one value; false: it is not JSON, or nested too deeply. */
static bool check_value(cursor_t *c)
{
    uint64_t objects = 0; /* one bit for each level: is it an object? */
    unsigned depth = 0;
    for (;;) {
        skip_space(c);
        if (c->at == c->end)
            return false;
        if (*c->at == '{' || *c->at == '[') {
            const bool object = *c->at == '{';
            if (depth == MAX_DEPTH)
                return false;
            c->at++;
            skip_space(c);
            if (c->at != c->end && *c->at == (object ? '}' : ']')) {
                c->at++;
            } else {
                objects = objects << 1 | (object ? 1u : 0u);
                depth++;
                if (object && !check_name(c))
                    return false;
                continue;
            }
        } else if (*c->at == '"') {
            if (!check_string(c))
                return false;
        } else if (*c->at == '-' || (*c->at >= '0' && *c->at <= '9')) {
            if (!check_number(c))
                return false;
        } else if (!check_word(c, "true") && !check_word(c, "false") && !check_word(c, "null")) {
            return false;
        }
        for (;;) {
            if (depth == 0)
                return true;
            skip_space(c);
            if (c->at == c->end)
                return false;
            if (*c->at == ',') {
                c->at++;
                if ((objects & 1u) != 0 && !check_name(c))
                    return false;
                break;
            }
            if (*c->at != ((objects & 1u) != 0 ? '}' : ']'))
                return false;
            c->at++;
            depth--;
            objects >>= 1;
        }
    }
}

/* A value as it stands in the line, without space around it. */
typedef struct slice {
    char *data;
    size_t size;
} slice_t;

static slice_t take(cursor_t *c)
{
    slice_t value;
    skip_space(c);
    value.data = c->at;
    (void)check_value(c);
    value.size = (size_t)(c->at - value.data);
    return value;
}

static char first_of(slice_t value)
{
    return value.size != 0 ? value.data[0] : '\0';
}

/* Begin to read the elements of an object or list. */
static cursor_t inside(slice_t value)
{
    cursor_t c;
    c.at = value.data + 1;
    c.end = value.data + value.size - 1;
    skip_space(&c);
    return c;
}

/* Go on to the next element; false: there is none. */
static bool more(cursor_t *c, bool first)
{
    skip_space(c);
    if (c->at == c->end)
        return false;
    if (!first)
        c->at++;
    return true;
}

static slice_t take_name(cursor_t *c)
{
    const slice_t name = take(c);
    skip_space(c);
    c->at++;
    return name;
}

static char *put_utf8(char *to, unsigned long code)
{
    if (code < 0x80u) {
        *to++ = (char)code;
    } else if (code < 0x800u) {
        *to++ = (char)(0xC0u | code >> 6);
        *to++ = (char)(0x80u | (code & 0x3Fu));
    } else if (code < 0x10000u) {
        *to++ = (char)(0xE0u | code >> 12);
        *to++ = (char)(0x80u | (code >> 6 & 0x3Fu));
        *to++ = (char)(0x80u | (code & 0x3Fu));
    } else {
        *to++ = (char)(0xF0u | code >> 18);
        *to++ = (char)(0x80u | (code >> 12 & 0x3Fu));
        *to++ = (char)(0x80u | (code >> 6 & 0x3Fu));
        *to++ = (char)(0x80u | (code & 0x3Fu));
    }
    return to;
}

/* Decode a string in its place. */
static dcp_text_t decode(slice_t string)
{
    const char *from = string.data + 1, *const end = string.data + string.size - 1;
    char *to = string.data;
    dcp_text_t text;
    while (from != end) {
        if (*from != '\\') {
            *to++ = *from++;
            continue;
        }
        from++;
        switch (*from) {
        case 'b': *to++ = '\b'; break;
        case 'f': *to++ = '\f'; break;
        case 'n': *to++ = '\n'; break;
        case 'r': *to++ = '\r'; break;
        case 't': *to++ = '\t'; break;
        case 'u': {
            unsigned long code = (unsigned long)hex4(from + 1);
            from += 4;
            if (code >= 0xD800u && code < 0xDC00u) {
                code = 0x10000u + ((code - 0xD800u) << 10) + ((unsigned long)hex4(from + 3) - 0xDC00u);
                from += 6;
            }
            to = put_utf8(to, code);
            break;
        }
        default: *to++ = *from; break;
        }
        from++;
    }
    text.data = string.data;
    text.size = (size_t)(to - string.data);
    return text;
}

static bool is(dcp_text_t text, const char *expected)
{
    return text.size == strlen(expected) && memcmp(text.data, expected, text.size) == 0;
}

/* ---- parameters ---------------------------------------------------------------------------------------------------- */

typedef enum kind { INTEGER, BOOLEAN, NUMBER, TEXT, HEX, NODE_ID, INTEGERS, OBJECT, SAFETY_DATA } kind_t;

typedef struct parameter {
    const char *name;
    kind_t kind;
    bool required;
    size_t at;    /* of the value in the structure */
    size_t given; /* of the member that tells whether it was given; NOT_TOLD */
} parameter_t;

#define NOT_TOLD SIZE_MAX

static bool read_integer(slice_t value, int64_t *integer)
{
    const bool negative = first_of(value) == '-';
    uint64_t number = 0;
    size_t i = negative ? 1u : 0u;
    if (i == value.size)
        return false;
    for (; i < value.size; i++) {
        const unsigned digit = (unsigned)(unsigned char)value.data[i] - '0';
        if (digit > 9u || number > (UINT64_MAX - digit) / 10u)
            return false;
        number = number * 10u + digit;
    }
    if (number > (uint64_t)INT64_MAX + (negative ? 1u : 0u))
        return false;
    *integer = !negative ? (int64_t)number : number == 0 ? 0 : -(int64_t)(number - 1u) - 1;
    return true;
}

static bool read_number(slice_t value, dcp_number_t *number)
{
    char text[64], *end;
    number->integer = 0;
    number->is_integer = read_integer(value, &number->integer);
    if (number->is_integer) {
        number->real = (double)number->integer;
        return true;
    }
    if (first_of(value) != '-' && (first_of(value) < '0' || first_of(value) > '9'))
        return false;
    if (value.size >= sizeof text)
        return false;
    memcpy(text, value.data, value.size);
    text[value.size] = '\0';
    number->real = strtod(text, &end);
    return *end == '\0' && number->real - number->real == 0.0;
}

/* Decode hexadecimal digits in their place; with colons they may be separated. */
static bool read_hex(slice_t value, bool colons, dcp_octets_t *octets)
{
    dcp_text_t text;
    size_t i = 0, count = 0;
    if (first_of(value) != '"')
        return false;
    text = decode(value);
    while (i < text.size) {
        int high, low;
        if (colons && count != 0 && text.data[i] == ':')
            i++;
        if (text.size - i < 2u || (high = hex_digit(text.data[i])) < 0 || (low = hex_digit(text.data[i + 1u])) < 0)
            return false;
        value.data[count++] = (char)(unsigned char)(high * 16 + low);
        i += 2u;
    }
    octets->data = (const uint8_t *)value.data;
    octets->size = count;
    return true;
}

static bool integers_only(slice_t list)
{
    cursor_t c = inside(list);
    bool first = true;
    int64_t ignored;
    for (; more(&c, first); first = false)
        if (!read_integer(take(&c), &ignored))
            return false;
    return true;
}

bool dcp_next_integer(dcp_text_t *list, int64_t *value)
{
    size_t i = 0, size;
    slice_t digits_only;
    while (i < list->size && (list->data[i] < '0' || list->data[i] > '9') && list->data[i] != '-')
        i++;
    for (size = 0; i + size < list->size && (list->data[i + size] == '-'
                                             || (list->data[i + size] >= '0' && list->data[i + size] <= '9')); size++)
        ;
    if (size == 0)
        return false;
    digits_only.data = (char *)(uintptr_t)(list->data + i);
    digits_only.size = size;
    list->data += i + size;
    list->size -= i + size;
    return read_integer(digits_only, value);
}

@SAFETY@
static bool read_value(kind_t kind, slice_t value, void *to)
{
    dcp_text_t text;
    switch (kind) {
    case INTEGER:
        return read_integer(value, (int64_t *)to);
    case BOOLEAN:
        *(bool *)to = first_of(value) == 't';
        return first_of(value) == 't' || first_of(value) == 'f';
    case NUMBER:
        return read_number(value, (dcp_number_t *)to);
    case TEXT:
        if (first_of(value) != '"')
            return false;
        *(dcp_text_t *)to = decode(value);
        return true;
    case HEX:
    case NODE_ID:
        return read_hex(value, kind == NODE_ID, (dcp_octets_t *)to);
    case INTEGERS:
        if (first_of(value) != '[' || !integers_only(value))
            return false;
        break;
    case OBJECT:
        if (first_of(value) != '{')
            return false;
        break;
    case SAFETY_DATA:
        return read_safety_data(value, to);
    }
    text.data = value.data;
    text.size = value.size;
    *(dcp_text_t *)to = text;
    return true;
}

static const char *const kind_names[] = {"an integer",  "true or false", "a number", "a string", "octets in hex",
                                         "a node identifier", "a list of integers", "an object",
                                         "all fields of SafetyDataT"};

/* Read the members of params into a structure that holds the defaults. */
static bool read_parameters(const char *method, slice_t params, const parameter_t *parameters, size_t count, void *into,
                            dcp_out_t *out)
{
    char message[200];
    uint32_t seen = 0;
    size_t i;
    if (params.size != 0 && first_of(params) != '{') {
        dcp_error(out, DCP_ERROR_INVALID_PARAMS, "parameters must be given by name, in an object");
        return false;
    }
    if (params.size != 0) {
        cursor_t c = inside(params);
        bool first = true;
        for (; more(&c, first); first = false) {
            const slice_t raw = take_name(&c), value = take(&c);
            const dcp_text_t name = decode(raw);
            for (i = 0; i < count && !is(name, parameters[i].name); i++)
                ;
            if (i == count) {
                (void)snprintf(message, sizeof message, "%s: unknown parameter", method);
                dcp_error(out, DCP_ERROR_INVALID_PARAMS, message);
                return false;
            }
            if (!read_value(parameters[i].kind, value, (char *)into + parameters[i].at)) {
                (void)snprintf(message, sizeof message, "%s: %s must be %s", method, parameters[i].name,
                               kind_names[parameters[i].kind]);
                dcp_error(out, DCP_ERROR_INVALID_PARAMS, message);
                return false;
            }
            if (parameters[i].given != NOT_TOLD)
                *(bool *)((char *)into + parameters[i].given) = true;
            seen |= (uint32_t)1 << i;
        }
    }
    for (i = 0; i < count; i++) {
        if (parameters[i].required && (seen >> i & 1u) == 0) {
            (void)snprintf(message, sizeof message, "%s: %s is missing", method, parameters[i].name);
            dcp_error(out, DCP_ERROR_INVALID_PARAMS, message);
            return false;
        }
    }
    return true;
}

/* ---- messages ------------------------------------------------------------------------------------------------------ */

static void begin_message(dcp_out_t *out)
{
    if (out->before != '\0')
        put(out, out->before);
    out->before = '\0';
    out->comma = false;
    dcp_begin_object(out, NULL);
    dcp_put_text(out, "jsonrpc", "2.0");
}

static void put_id(dcp_out_t *out)
{
    put_name(out, "id");
    put_raw(out, out->id);
}

void dcp_result(dcp_out_t *out, dcp_status_t status)
{
    begin_message(out);
    put_id(out);
    dcp_begin_object(out, "result");
    dcp_put_text(out, "status", dcp_status_name(status));
    out->open = true;
}

void dcp_error(dcp_out_t *out, int code, const char *message)
{
    begin_message(out);
    put_id(out);
    dcp_begin_object(out, "error");
    dcp_put_integer(out, "code", code);
    dcp_put_text(out, "message", message);
    out->open = true;
}

static void null_id(dcp_out_t *out)
{
    out->id.data = "null";
    out->id.size = 4;
}

void dcp_line_too_long(dcp_out_t *out)
{
    null_id(out);
    dcp_error(out, DCP_ERROR_INVALID_REQUEST, "the line is too long");
    put_string(out, "}}");
    end_line(out);
}

@DISPATCH@
/* Find the method of a request and call it. */
static void request(const dcp_methods_t *methods, void *node, slice_t message, dcp_out_t *out)
{
    slice_t id = {NULL, 0}, method = {NULL, 0}, params = {NULL, 0};
    const char *wrong = NULL;
    bool version = false;
    null_id(out);
    if (first_of(message) != '{') {
        wrong = "a request must be an object";
    } else {
        cursor_t c = inside(message);
        bool first = true;
        for (; more(&c, first); first = false) {
            const slice_t raw = take_name(&c), value = take(&c);
            const dcp_text_t name = decode(raw);
            if (is(name, "id"))
                id = value;
            else if (is(name, "method"))
                method = value;
            else if (is(name, "params"))
                params = value;
            else if (is(name, "jsonrpc"))
                version = value.size == 5 && memcmp(value.data, "\"2.0\"", 5) == 0;
            else
                wrong = "the request has an unknown member";
        }
        if (first_of(id) == '{' || first_of(id) == '[' || first_of(id) == 't' || first_of(id) == 'f') {
            wrong = "an id must be a string, a number or null";
            id.size = 0;
        }
        if (wrong == NULL && !version)
            wrong = "the request has no \"jsonrpc\": \"2.0\"";
        if (wrong == NULL && first_of(method) != '"')
            wrong = "the request has no method";
    }
    if (id.size != 0) {
        out->id.data = id.data;
        out->id.size = id.size;
    } else if (wrong == NULL) {
        out->muted = true;
    }
    if (wrong != NULL)
        dcp_error(out, DCP_ERROR_INVALID_REQUEST, wrong);
    else
        call(methods, node, decode(method), params, out);
}

/* Answer one request; false: it wants no answer. */
static bool answer(const dcp_methods_t *methods, void *node, slice_t message, dcp_out_t *out)
{
    out->open = false;
    request(methods, node, message, out);
    if (!out->open)
        dcp_error(out, DCP_ERROR_INTERNAL, "the method has not answered");
    put_string(out, "}}");
    if (!out->muted)
        return true;
    out->muted = false;
    return false;
}

/* Answer the requests of a list; false: none wants an answer. */
static bool batch(const dcp_methods_t *methods, void *node, slice_t list, dcp_out_t *out)
{
    cursor_t c = inside(list);
    size_t count = 0;
    bool first = true, answered = false;
    for (; more(&c, first); first = false, count++)
        (void)take(&c);
    if (count == 0 || count > DCP_MAX_BATCH) {
        dcp_error(out, DCP_ERROR_INVALID_REQUEST, count == 0 ? "the batch is empty" : "the batch has too many requests");
        put_string(out, "}}");
        return true;
    }
    c = inside(list);
    for (first = true; more(&c, first); first = false) {
        const slice_t message = take(&c);
        out->before = answered ? ',' : '[';
        answered = answer(methods, node, message, out) || answered;
    }
    out->before = '\0';
    if (answered)
        put(out, ']');
    return answered;
}

void dcp_handle_line(const dcp_methods_t *methods, void *node, char *line, size_t size, dcp_out_t *out)
{
    cursor_t c;
    slice_t message;
    c.at = line;
    c.end = line + size;
    skip_space(&c);
    if (c.at == c.end)
        return;
    message.data = c.at;
    null_id(out);
    if (!check_value(&c)) {
        dcp_error(out, DCP_ERROR_PARSE, "the line is not JSON");
        put_string(out, "}}");
        end_line(out);
        return;
    }
    message.size = (size_t)(c.at - message.data);
    skip_space(&c);
    if (c.at != c.end) {
        dcp_error(out, DCP_ERROR_PARSE, "something follows the request in its line");
        put_string(out, "}}");
    } else if (first_of(message) != '[') {
        if (!answer(methods, node, message, out))
            return;
    } else if (!batch(methods, node, message, out)) {
        return;
    }
    end_line(out);
}
