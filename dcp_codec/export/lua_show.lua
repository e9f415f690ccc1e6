-- What is made of a message that was taken apart: warnings, labels, the Info column.

local function hex(octets)
    return (octets:gsub(".", function(octet) return string.format("%02x", octet:byte()) end))
end

-- Whether the octets are UTF-8: no overlong forms, no surrogates, nothing above U+10FFFF.
local function is_utf8(octets)
    local at = 1
    while at <= #octets do
        local first, second = octets:byte(at, at + 1)
        local more, low, high = 0, 0x80, 0xBF
        if first >= 0xC2 and first <= 0xDF then
            more = 1
        elseif first >= 0xE0 and first <= 0xEF then
            more, low, high = 2, first == 0xE0 and 0xA0 or 0x80, first == 0xED and 0x9F or 0xBF
        elseif first >= 0xF0 and first <= 0xF4 then
            more, low, high = 3, first == 0xF0 and 0x90 or 0x80, first == 0xF4 and 0x8F or 0xBF
        elseif first >= 0x80 then
            return false
        end
        if more > 0 and (second == nil or second < low or second > high) then
            return false
        end
        for further = 2, more do
            local octet = octets:byte(at + further)
            if octet == nil or octet < 0x80 or octet > 0xBF then
                return false
            end
        end
        at = at + 1 + more
    end
    return true
end

local function node_text(octets)
    if PROFILE.node_ids == "text" then
        -- Wireshark takes labels that are not UTF-8 as they are and hands them on.
        return is_utf8(octets) and octets or (octets:gsub("[\128-\255]", "?"))
    end
    local digits = hex(octets)
    return PROFILE.node_ids == "mac" and digits:gsub("%x%x", "%0:"):sub(1, -2) or digits
end

-- Every record of a message, outer ones first.
local function each_record(found, use)
    if found.has then
        use(found)
        for _, name in ipairs(found.order) do
            each_record(found.has[name], use)
        end
    else
        for _, element in ipairs(found) do
            each_record(element, use)
        end
    end
end

-- The value of a field as comparable text, nil for one that is cut off or not there.
local function text_of(record, name)
    local field = record and record.has and record.has[name]
    return field and (field.text or field.octets)
end

-- ------------------------------------------------------------------------------------- rules (as dcp_codec.lint)

local function warn(s, field, reason, requirement, needed, available)
    problem(s, field.item, reason, field.path, field.offset, needed, available, requirement)
end

local rules = {}

function rules.Payload(s, payload)
    if text_of(payload, "length") == "0" then
        warn(s, payload.has.length, "empty-payload", "BP-TXP-03", 1, 0)
    end
end

function rules.VarUpdate(s, update)
    if text_of(update, "value") == "" then
        warn(s, update.has.value, "empty-value", "VD-TYP-02", 1, 0)
    end
end

function rules.VarSpec(s, spec)
    local descr = text_of(spec, "descr")
    if text_of(spec, "repCnt") == "0" then
        warn(s, spec.has.repCnt, "zero-repetitions", "VD-PC-06", 1, 0)
    end
    if descr == "" then
        warn(s, spec.has.descr, "empty-description", "VD-PC-05", 1, 0)
    end
    if descr and not is_utf8(descr) then
        warn(s, spec.has.descr, "invalid-utf8", "DATA-08")
    end
end

function rules.VarCreate(s, create)
    local first, second = text_of(create.has.spec, "varId"), text_of(create.has.upd, "varId")
    if first and second and first ~= second then
        warn(s, create.has.upd.has.varId, "id-mismatch", "VD-TYP-07", first, second)
    end
end

function rules.Container(s, container)
    local seen = {}
    for _, element in ipairs(container.has.records or {}) do
        local owner = element.has.spec or element
        local id = text_of(owner, "varId")
        if id and seen[id] then
            warn(s, owner.has.varId, "duplicate-variable", "VD-PAY-03", nil, id)
        end
        seen[id or ""] = true
    end
end

function rules.ExtendedSafetyData(s, report)
    local node, sender = text_of(report, "nodeId"), s.sender
    if PROFILE.node_ids ~= "text" and node and sender and node ~= sender then
        warn(s, report.has.nodeId, "foreign-node-id", "SRP-TYP-04")
    end
end

-- ---------------------------------------------------------------------------------------------------- labels

local function container_text(container)
    local type = container.has.icType
    local name = type and type.n and (CONTAINERS[type.n] or "type " .. type.text) or "cut off"
    return name, container.has.records and #container.has.records or 0
end

-- The protocol of a payload block and its content, as short as the Info column needs it.
local function payload_text(payload)
    local id = payload.has.protocolId
    local name = id and id.n and (PROTOCOLS[id.n] or "protocol " .. id.text) or "cut off"
    local parts = {}
    for _, container in ipairs(payload.has.vardis or {}) do
        parts[#parts + 1] = string.format("%s %d", container_text(container))
    end
    return #parts > 0 and string.format("%s [%s]", name, table.concat(parts, ", ")) or name
end

local labels = {}

function labels.BPHeader(header)
    local sender = text_of(header, "senderId")
    return string.format("Beaconing Protocol: seqno %s from %s", text_of(header, "seqno") or "-",
        sender and node_text(sender) or "-")
end

function labels.Payload(payload)
    return string.format("Payload %d: %s, %s octets", payload.number, payload_text(payload),
        text_of(payload, "length") or "-")
end

function labels.ExtendedSafetyData(report)
    local node = text_of(report, "nodeId")
    return string.format("State Reporting Protocol: report %s of %s", text_of(report, "seqno") or "-",
        node and node_text(node) or "-")
end

function labels.Container(container)
    local name, count = container_text(container)
    return string.format("VarDis container %d: %s, %d record%s", container.number, name, count, count == 1 and "" or "s")
end

-- Any other record: its type and the fields that name it.
local function label(record)
    if labels[record.type] then
        return labels[record.type](record)
    end
    local owner, parts = record.has.spec or record, {}
    for _, name in ipairs({ "varId", "seqno" }) do
        local text = text_of(owner, name)
        parts[#parts + 1] = text and string.format("%s %s", name, text)
    end
    local number = record.number and string.format("Record %d: ", record.number) or ""
    return number .. record.type .. (#parts > 0 and ", " .. table.concat(parts, ", ") or "")
end

local function info(s, beacon)
    local header, parts = beacon.has.bp, {}
    for _, payload in ipairs(beacon.has.payloads or {}) do
        parts[#parts + 1] = payload_text(payload)
    end
    local text = table.concat(parts, ", ")
    if header then
        local sender = text_of(header, "senderId")
        text = string.format("BP seqno %s from %s: %s", text_of(header, "seqno") or "-",
            sender and node_text(sender) or "-", text)
    end
    return s.errors[1] and string.format("%s [%s]", text, s.errors[1].reason) or text
end

-- ------------------------------------------------------------------------------------------------- the dissector

local earlier -- the dissector of a script for another profile that was loaded before this one

-- Stands in for an item of the tree: takes everything, shows nothing.
local nothing = {}
setmetatable(nothing, { __index = function()
    return function()
        return nothing
    end
end })

-- Whether the layout explains the octets without an error.
local function explains(buf)
    local size = buf:len()
    local s = { buf = buf, pos = 0, size = size, base = buf:offset(), quiet = 0, errors = {}, warnings = {}, root = nothing }
    visit[LAYOUT.kind](s, LAYOUT, nothing, "", size, {})
    return #s.errors == 0
end

function dcp.dissector(buf, pinfo, tree)
    -- Wireshark offers a datagram by either port; the destination port is what makes it a beacon.
    if PROFILE.table == "udp.port" and pinfo.match_uint == pinfo.src_port and pinfo.src_port ~= pinfo.dst_port then
        return 0
    end
    if earlier and not explains(buf) then
        return earlier:call(buf(0):tvb(), pinfo, tree)
    end
    local size = buf:len()
    local root = tree:add(dcp, buf(0, size))
    local s = { buf = buf, pos = 0, size = size, base = buf:offset(), quiet = 0, errors = {}, warnings = {}, root = root }
    local going, beacon = visit[LAYOUT.kind](s, LAYOUT, root, "", size, {})
    -- Octets after a message that could not be read to its end need not be padding.
    local ends = going and s.pos or size
    s.sender = beacon.has.bp and text_of(beacon.has.bp, "senderId")
    each_record(beacon, function(record)
        if record ~= beacon then
            record.item:set_text(label(record))
        end
        if rules[record.type] and not record.wrong then
            rules[record.type](s, record)
        end
    end)
    if s.pos > 0 then
        root:set_len(s.pos)
    end
    if ends < size then
        root:add(F.padding, buf(ends, size - ends), size - ends):append_text(" octets after the beacon")
    end
    show_problems(s, "errors", s.errors)
    show_problems(s, "warnings", s.warnings)
    local text = info(s, beacon)
    root:append_text(text ~= "" and ", " .. text or "")
    pinfo.cols.protocol = "DCP"
    pinfo.cols.info = text
    return size
end

for _, name in ipairs({ "ethertype", "udp.port" }) do
    local dissectors = DissectorTable.get(name)
    if name == PROFILE.table then
        local there = dissectors:get_dissector(PROFILE.number)
        earlier = there and tostring(there):lower():find("^dcp") and there or nil
        dissectors:add(PROFILE.number, dcp)
    else
        dissectors:add_for_decode_as(dcp)
    end
end
