-- The interpreter of the tables above. It walks the layout as dcp_codec.dissect does: the first problem is the one
-- that the strict decoder reports, and it goes on wherever the layout allows. Written for Lua 5.2 to 5.4, so without
-- the operators // and &, and with dec() where 5.4 would print 3.0.

-- Several of these scripts can be loaded, one for each profile: the first is the protocol dcp. Field names are the
-- same in all of them.
local named, dcp = pcall(Proto, "dcp", "Drone Coordination Protocol")
if not named then
    local short = PROFILE.name:lower():gsub("[^a-z0-9]+", "_")
    dcp = Proto("dcp_" .. short, "Drone Coordination Protocol, profile " .. PROFILE.name)
end

local F = {} -- ProtoField by path
for _, field in ipairs(FIELDS) do
    F[field.path] = ProtoField.new(
        field.name, "dcp." .. field.path, ftypes[field.type], field.values, field.base and base[field.base], nil, field.doc)
end
dcp.fields = F

local E = {} -- ProtoExpert by reason
for reason, meaning in pairs(REASONS) do
    E[reason] = ProtoExpert.new("dcp.expert." .. reason, meaning, expert.group.MALFORMED, expert.severity.ERROR)
end
for reason, meaning in pairs(WARNINGS) do
    E[reason] = ProtoExpert.new("dcp.expert." .. reason, meaning, expert.group.PROTOCOL, expert.severity.WARN)
end
dcp.experts = E

-- ------------------------------------------------------------------------------------------------- small helpers

local function dec(number)
    return string.format("%.0f", number)
end

-- The octets of a part of the message as a Lua string.
local function octets_of(s, start, size)
    return size > 0 and s.buf(start, size):raw() or ""
end

-- An integer as a Lua number, rounded above 2^53, and exactly as decimal text.
local function integer(range, node)
    local little, size = node.order == "little", node.size
    if size > 4 then
        local value
        if node.signed then
            value = little and range:le_int64() or not little and range:int64()
        else
            value = little and range:le_uint64() or not little and range:uint64()
        end
        return value:tonumber(), tostring(value)
    end
    local value = little and range:le_uint() or not little and range:uint()
    if node.signed and value >= 2 ^ (8 * size - 1) then
        value = value - 2 ^ (8 * size)
    end
    return value, dec(value)
end

-- --------------------------------------------------------------------------------------------------- problems

-- What was needed and what was there, in words; nil if the problem has no numbers.
local function quantity(reason, needed, available)
    if COMPARISONS[reason] then
        local expected, there = needed and "expected " .. needed, available and "found " .. available
        return expected and there and expected .. ", " .. there or expected or there
    elseif reason == "leftover" then
        return string.format("%s octets too many", available)
    elseif needed or available then
        return string.format("needs %s octets, %s there", needed, available)
    end
end

-- Note a problem at the octet `offset` of the message and mark `item`. `needed` and `available` are numbers, decimal
-- text (beyond 2^53) or nil.
local function problem(s, item, reason, path, offset, needed, available, requirement)
    if s.quiet > 0 then
        return
    end
    local list = WARNINGS[reason] and s.warnings or s.errors
    local found = { reason = reason, path = path, offset = offset, requirement = requirement }
    found.needed = type(needed) == "number" and dec(needed) or needed
    found.available = type(available) == "number" and dec(available) or available
    list[#list + 1] = found
    local numbers = quantity(reason, found.needed, found.available)
    local text = reason .. (numbers and string.format(" (%s)", numbers) or "")
    text = text .. ": " .. (REASONS[reason] or WARNINGS[reason])
    item:add_proto_expert_info(E[reason], requirement and string.format("%s [%s]", text, requirement) or text)
end

local function show_problems(s, kind, list)
    for _, found in ipairs(list) do
        local at = math.min(found.offset, s.size)
        local range = s.buf(at, math.min(1, s.size - at))
        local item = s.root:add(F[kind], range):set_generated()
        item:set_text(string.format("%s: %s in %s", kind == "errors" and "Error" or "Warning", found.reason,
            found.path == "" and "beacon" or found.path))
        item:add(F[kind .. ".reason"], range, found.reason):set_generated()
        item:add(F[kind .. ".path"], range, found.path):set_generated()
        item:add(F[kind .. ".offset"], range, s.base + found.offset):set_generated()
        for _, name in ipairs({ "needed", "available" }) do
            if found[name] and found[name]:sub(1, 1) ~= "-" then
                item:add(F[kind .. "." .. name], range, UInt64(found[name])):set_generated()
            end
        end
        if found.requirement then
            item:add(F[kind .. ".requirement"], range, found.requirement):set_generated()
        end
    end
end

-- ------------------------------------------------------------------------------------------------------- walking

-- visit[kind](s, node, tree, path, stop, scope) reads one part at s.pos, which ends at `stop` at the latest, and
-- returns whether to continue after it, and the result: for a field {n, text, octets, path, offset, item}, for a
-- record {type, item, has}, for a list its records.
local visit = {}

local function resolve(scope, reference)
    local first, second = reference:match("^([^.]*)%.?(.*)$")
    local found = scope[first]
    return second ~= "" and found[second] or found
end

-- A field that ends after the region: only its present octets, without a value.
local function cut_off(s, node, tree, path, start, stop, needed, requirement, offset)
    local text = string.format("%s: cut off (%s octets)", node.name, dec(stop - start))
    local item = tree:add(s.buf(start, stop - start), text)
    problem(s, item, "truncated", path, offset or start, needed, offset and 0 or stop - start, requirement)
    s.pos = stop
    return false, { path = path, offset = start, item = item }
end

-- A time stamp as a date, when it is one between 1970 and 9999.
local function show_date(node, range, tree, text)
    if text:sub(1, 1) == "-" then
        return
    end
    local value = node.order == "little" and range:le_uint64() or range:uint64()
    local per_second = UInt64(node.per_second)
    local seconds = (value / per_second):tonumber()
    if seconds < 253402300800 then
        local rest = (value % per_second):tonumber()
        local date = NSTime(seconds, math.floor(rest * (1e9 / node.per_second)))
        tree:add(F[node.date], range, date):set_generated()
    end
end

function visit.scalar(s, node, tree, path, stop, scope)
    local start = s.pos
    if start + node.size > stop then
        return cut_off(s, node, tree, path, start, stop, node.size, node.requirement)
    end
    local range = s.buf(start, node.size)
    s.pos = start + node.size
    local add = node.order == "little" and tree.add_le or tree.add
    local found = { path = path, offset = start, item = add(tree, F[node.field], range) }
    if node.unit then
        found.item:append_text(" " .. node.unit)
    end
    if node.type == "int" then
        found.n, found.text = integer(range, node)
        if node.per_second then
            show_date(node, range, found.item, found.text)
        end
        local rule = node.rule
        if rule and (rule.value and found.text ~= dec(rule.value) or not rule.value and found.text == "0") then
            problem(s, found.item, rule.reason, path, start, rule.value or 1, found.text, rule.requirement)
        end
    elseif node.type == "bytes" then
        found.octets = range:raw()
    end
    scope[node.name] = found
    return true, found
end

-- The octets of a string or value, and separately the NUL that ends it.
local function show_text(s, node, tree, path, start, size)
    local octets, ended = octets_of(s, start, size), 0
    if node.terminated and octets:sub(-1) == "\0" then
        octets, ended = octets:sub(1, -2), 1
    end
    local range = s.buf(start, #octets)
    local found = { path = path, offset = start, octets = octets }
    if node.human then
        found.item = tree:add_packet_field(F[node.field], range, ENC_UTF_8)
    else
        found.item = tree:add(F[node.field], range)
    end
    if ended > 0 then
        tree:add(F[node.field .. ".terminator"], s.buf(start + #octets, 1))
    end
    return found
end

function visit.text(s, node, tree, path, stop)
    local whole, inner = s.pos, {}
    for _, prefix in ipairs(node.prefixes) do
        local going = visit.scalar(s, prefix, tree, path .. "." .. prefix.name, stop, inner)
        if not going then
            return false, nil
        end
    end
    local start, first = s.pos, node.prefixes[1]
    if first == nil then
        local nul = octets_of(s, start, stop - start):find("\0", 1, true)
        if nul == nil then
            return cut_off(s, node, tree, path, start, stop, 1, node.requirement, stop)
        end
        s.pos = start + nul
        return true, show_text(s, node, tree, path, start, nul)
    end
    local length = inner[first.name]
    for number = 2, #node.prefixes do
        local other = inner[node.prefixes[number].name]
        if other.text ~= length.text then
            problem(s, other.item, "length-mismatch", other.path, other.offset, length.text, other.text, "DATA-06")
        end
    end
    if start + length.n > stop or length.n < 0 then
        return cut_off(s, node, tree, path .. ".data", start, stop, length.text, node.requirement)
    end
    s.pos = start + length.n
    local found = show_text(s, node, tree, path, start, length.n)
    if node.terminated then
        local nul = octets_of(s, start, length.n):find("\0", 1, true)
        if nul ~= length.n then
            problem(s, found.item, "bad-terminator", path .. ".data", start, nil, nil, "DATA-07")
        end
    end
    found.offset = whole
    return true, found
end

function visit.rest(s, node, tree, path, stop)
    local start = s.pos
    s.pos = stop
    return true, { path = path, offset = start, item = tree:add(F[node.field], s.buf(start, stop - start)) }
end

function visit.fill(s, node, tree, path, stop, scope)
    local used, start = resolve(scope, node.used), s.pos
    if used.n > node.total then
        problem(s, used.item, node.reason, used.path, used.offset, used.text, node.total, node.requirement)
        -- Where the next block would be is not known: what is left belongs to the area that is none.
        s.pos = stop
        return false, { path = path, offset = start, item = tree:add(F[node.field], s.buf(start, stop - start)) }
    end
    local size = node.total - used.n
    if start + size > stop then
        return cut_off(s, node, tree, path, start, stop, size, node.requirement)
    end
    s.pos = start + size
    return true, { path = path, offset = start, item = tree:add(F[node.field], s.buf(start, size)) }
end

-- A record with an item of its own in the tree; the outermost one is the protocol's item.
local function record(s, node, tree, path, stop, scope)
    local start, item = s.pos, tree
    if node.field then
        item = tree:add(F[node.field], s.buf(start, stop - start))
    end
    local found, going = { type = node.record, item = item, path = path, has = {}, order = {} }, true
    for _, member in ipairs(node.members) do
        local here, value = path, nil
        -- A chosen content goes by the label of the choice, not by the name of the member.
        if member.kind ~= "region" and member.kind ~= "select" then
            here = path == "" and member.name or path .. "." .. member.name
        end
        going, value = visit[member.kind](s, member, item, here, stop, scope)
        if value then
            local name = value.label or member.name
            found.has[name], found.order[#found.order + 1] = value, name
        end
        if not going then
            break
        end
    end
    if node.field and s.pos > start then
        item:set_len(s.pos - start)
    end
    return going, found
end

function visit.group(s, node, tree, path, stop, scope)
    local inner = {}
    scope[node.name] = inner
    return record(s, node, tree, path, stop, inner)
end

function visit.many(s, node, tree, path, stop, scope)
    local list, going = {}, true
    local count = node.count and resolve(scope, node.count).n
    while going and #list < (count or math.huge) and (count or s.pos < stop or (node.nonempty and #list == 0)) do
        local number = #list
        going, list[number + 1] = record(s, node.element, tree, string.format("%s[%d]", path, number), stop, {})
        list[number + 1].number = number + 1
    end
    local announced = going and node.agrees and resolve(scope, node.agrees)
    if announced and announced.n ~= #list then
        problem(s, announced.item, node.reason, announced.path, announced.offset, announced.text, #list,
            node.requirement)
    end
    return going, list
end

function visit.region(s, node, tree, path, stop, scope)
    local length, start, content = resolve(scope, node.length), s.pos, node.content
    local ends, clipped = start + length.n, false
    if ends > stop or ends < start then
        problem(s, length.item, node.reason, length.path, length.offset, length.text, stop - start, node.requirement)
        ends, clipped = stop, true
    end
    local outer = s.clipped
    s.clipped = clipped
    local here = path
    if content.kind ~= "select" then
        here = path == "" and content.name or path .. "." .. content.name
    end
    local going, found = visit[content.kind](s, content, tree, here, ends, scope)
    s.clipped = outer
    if going and not clipped and s.pos < ends then
        if content.kind == "select" then
            here = (path == "" and "" or path .. ".") .. found.label
        end
        problem(s, found.item or tree, "leftover", here, s.pos, 0, ends - s.pos, node.requirement)
    end
    s.pos = ends
    return not clipped, found
end

function visit.exact(s, node, tree, path, stop)
    local start, size = s.pos, stop - s.pos
    local wrong = size ~= node.size
    -- What is there is still shown, but the one mistake is reported once, which may be that the region is cut off.
    s.quiet = s.quiet + (wrong and 1 or 0)
    local _, found = record(s, node.content, tree, path, stop, {})
    s.quiet = s.quiet - (wrong and 1 or 0)
    found.wrong = wrong
    if wrong and not s.clipped then
        problem(s, found.item, node.reason, path, start, node.size, size, node.requirement)
    end
    s.pos = stop
    return true, found
end

function visit.select(s, node, tree, path, stop, scope)
    local key = resolve(scope, node.key)
    local case = node.cases[key.text] or node.default
    if case == nil then
        problem(s, key.item, node.reason, key.path, key.offset, nil, key.text, node.requirement)
        local _, found = visit.rest(s, node.unknown, tree, path .. ".data", stop)
        return false, found
    end
    local here = path == "" and case.name or path .. "." .. case.name
    local going, found = visit[case.kind](s, case, tree, here, stop, scope)
    if found then
        found.label = case.name
    end
    return going, found
end
