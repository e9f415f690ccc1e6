"""The upper tester's contract as C: structures, parameter tables and calls from its published schema."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from importlib import resources
from typing import Any

import msgspec
from dcp_spec.version import __version__

from dcp_codec.codec import Codec
from dcp_codec.export.shape import shape_of
from dcp_codec.export.wording import constant, snake_name
from dcp_codec.plan.measures import largest
from dcp_codec.plan.tree import Group, Scalar

from .files import filled, header_file, names_function, template
from .header import heading
from .names import comment, member_name, value_type

_TYPES = {
    "INTEGER": "int64_t",
    "BOOLEAN": "bool",
    "NUMBER": "dcp_number_t",
    "TEXT": "dcp_text_t",
    "HEX": "dcp_octets_t",
    "NODE_ID": "dcp_octets_t",
    "INTEGERS": "dcp_text_t",
    "OBJECT": "dcp_text_t",
    "SAFETY_DATA": "dcp_safety_data_t",
}


def adapter_files(codec: Codec) -> dict[str, str]:
    """Return ``dcp_adapter.h`` and ``dcp_adapter.c`` for a profile."""
    contract = _Contract(codec)
    first = heading(codec.profile, __version__, " --adapter")
    marks = {
        "TYPES": contract.types(),
        "SAFETY_DECLARATION": contract.safety_declaration(),
        "NOTIFICATION_DECLARATIONS": "\n".join(f"{each};" for each in contract.notification_signatures()),
    }
    header = filled(template("adapter.h"), marks).rstrip()
    source = template("adapter.c")
    source = source.replace("@SAFETY@\n", contract.safety()).replace("@DISPATCH@", contract.dispatch())
    source += "\n" + contract.statuses() + contract.notifications()
    return {
        "dcp_adapter.h": header_file("DCP_ADAPTER", first, '#include "dcp_codec.h"', header),
        "dcp_adapter.c": f"{first}\n{_INCLUDES}\n{source.rstrip()}\n",
    }


class _Contract:
    """The schema with its methods in the order of the contract."""

    def __init__(self, codec: Codec) -> None:
        path = resources.files("dcp_spec").joinpath("data", "upper-tester.schema.json")
        self.definitions: dict[str, Any] = msgspec.json.decode(path.read_bytes())["$defs"]
        names = [each["$ref"].rpartition("/")[2] for each in self.definitions["message"]["anyOf"]]
        self.methods = [name.removesuffix(".request") for name in names if name.endswith(".request")]
        self.notices = [name for name in names if name not in self.definitions or self._is_notice(name)]
        shape = shape_of(codec)
        record = shape.srp.group if shape.srp is not None else None
        found = [each for each in record.members if isinstance(each, Group)] if record is not None else []
        self.safety_data = [each for each in found[0].members if isinstance(each, Scalar)] if found else []

    def _is_notice(self, name: str) -> bool:
        return not name.endswith(".request") and "method" in self.definitions[name].get("properties", {})

    def _params(self, name: str) -> tuple[str, Mapping[str, Any]]:
        reference = self.definitions[name]["properties"]["params"]["$ref"].rpartition("/")[2]
        return reference, self.definitions[reference]

    def _requests(self) -> dict[str, Mapping[str, Any]]:
        """Return the parameter structures by name; those without members are left out."""
        found = dict(self._params(f"{method}.request") for method in self.methods)
        return {name: params for name, params in found.items() if params.get("properties")}

    def _kind(self, name: str, schema: Mapping[str, Any]) -> str:
        if name == "sData" and self.safety_data:
            return "SAFETY_DATA"
        if "anyOf" in schema:
            return "NUMBER"
        pattern = schema.get("pattern", "")
        if schema["type"] == "string" and "[0-9A-Fa-f]" in pattern:
            return "NODE_ID" if ":?" in pattern else "HEX"
        return {
            "integer": "INTEGER",
            "boolean": "BOOLEAN",
            "string": "TEXT",
            "array": "INTEGERS",
            "object": "OBJECT",
        }[schema["type"]]

    def _members(self, params: Mapping[str, Any]) -> Iterator[tuple[str, str, bool, bool, Mapping[str, Any]]]:
        """Yield name, kind, whether it is required, whether a member states its presence, and the schema."""
        for name, schema in params["properties"].items():
            required = name in params["required"]
            yield name, self._kind(name, schema), required, not required and "default" not in schema, schema

    # -- header -------------------------------------------------------------------------------------------------

    def types(self) -> str:
        """Return statuses, parameter structures and the table of methods."""
        lines = ["/* The statuses of the specification, and that of the upper tester. */", "typedef enum dcp_status {"]
        lines += [",\n".join(f"    DCP_{constant(name)}" for name in self._statuses()), "} dcp_status_t;", ""]
        for name, params in self._requests().items():
            lines += comment(f"{name}: {params.get('description', '')}")
            lines += [f"typedef struct dcp_{snake_name(name)}_params {{"]
            for member, kind, _, told, schema in self._members(params):
                text = schema.get("description", "")
                if kind == "INTEGERS":
                    text += " Read them with dcp_next_integer."
                elif kind == "OBJECT":
                    text += " An object as JSON."
                lines += comment(text, "    ") if text else []
                lines.append(f"    {_TYPES[kind]} {member_name(member)};")
                lines += [f"    bool has_{member_name(member)};"] if told else []
            lines += [f"}} dcp_{snake_name(name)}_params_t;", ""]
        lines += ["/* One function for each method of the contract; NULL: the node has no such method. Each calls"]
        lines += [
            " * dcp_result or dcp_error once; node is that of dcp_handle_line. */",
            "typedef struct dcp_methods {",
        ]
        for method in self.methods:
            lines += comment(self.definitions[f"{method}.request"].get("description", method), "    ")
            lines.append(f"    void (*{_function(method)})(void *node{self._argument(method)}, dcp_out_t *out);")
        return "\n".join([*lines, "} dcp_methods_t;"])

    def _argument(self, method: str) -> str:
        name, params = self._params(f"{method}.request")
        return f", const dcp_{snake_name(name)}_params_t *params" if params.get("properties") else ""

    def _statuses(self) -> list[str]:
        found = ["UT-STATUS-OK"]
        for name in ("BPStatus", "SRPStatus", "VardisStatus"):
            found += self.definitions[name]["enum"]
        return found

    # -- source -------------------------------------------------------------------------------------------------

    def statuses(self) -> str:
        """Return the names of the statuses."""
        return names_function("status", self._statuses()) + "\n"

    def dispatch(self) -> str:
        """Return the parameter tables and the function that calls methods."""
        lines: list[str] = []
        for name, params in self._requests().items():
            stem = f"dcp_{snake_name(name)}_params_t"
            lines.append(f"static const parameter_t {snake_name(name)}_params[] = {{")
            for member, kind, required, told, _ in self._members(params):
                given = f"offsetof({stem}, has_{member_name(member)})" if told else "NOT_TOLD"
                place = f"offsetof({stem}, {member_name(member)})"
                lines.append(f'    {{"{member}", {kind}, {"true" if required else "false"}, {place}, {given}}},')
            lines += ["};", ""]
        lines += ["static void call(const dcp_methods_t *methods, void *node, dcp_text_t method, slice_t params,"]
        lines += ["                 dcp_out_t *out)", "{"]
        for method in self.methods:
            name, params = self._params(f"{method}.request")
            function, stem = _function(method), snake_name(name)
            lines.append(f'    if (is(method, "{method}") && methods->{function} != NULL) {{')
            if params.get("properties"):
                lines += [f"        dcp_{stem}_params_t given;", "        memset(&given, 0, sizeof given);"]
                lines.append(
                    f'        if (read_parameters("{method}", params, {stem}_params, '
                    f"sizeof {stem}_params / sizeof *{stem}_params,"
                )
                lines += ["                            &given, out))"]
                lines += [f"            methods->{function}(node, &given, out);"]
            else:
                lines += [f'        if (read_parameters("{method}", params, NULL, 0, NULL, out))']
                lines += [f"            methods->{function}(node, out);"]
            lines += ["        return;", "    }"]
        lines += ['    dcp_error(out, DCP_ERROR_NO_METHOD, "no such method; UT-Hello lists the methods");', "}", ""]
        lines += ["void dcp_put_methods(dcp_out_t *out, const char *name, const dcp_methods_t *methods)", "{"]
        lines.append("    dcp_begin_list(out, name);")
        for method in self.methods:
            lines += [f"    if (methods->{_function(method)} != NULL)", f'        dcp_put_text(out, NULL, "{method}");']
        return "\n".join([*lines, "    dcp_end_list(out);", "}", ""])

    def safety_declaration(self) -> str:
        """Return the declaration of the function that writes SafetyDataT; empty without one."""
        if not self.safety_data:
            return ""
        return (
            "/* SafetyDataT, by the names of the profile. */\n"
            "void dcp_put_safety_data(dcp_out_t *out, const char *name, const dcp_safety_data_t *data);"
        )

    def safety(self) -> str:
        """Return the functions that read and write SafetyDataT."""
        if not self.safety_data:
            return _NO_SAFETY
        kinds = {member.kind for member in self.safety_data}
        lines = [template("adapter_real.c")] if "float" in kinds else []
        lines += ["static bool read_safety_data(slice_t value, void *to)", "{", "    dcp_safety_data_t *v = to;"]
        lines += ["    cursor_t c;", "    bool first = true;", "    uint64_t seen = 0;"]
        lines += ["    int64_t integer;"] if "int" in kinds else []
        lines += ["    double real;"] if "float" in kinds else []
        lines += ["    dcp_octets_t octets;"] if "bytes" in kinds else []
        lines += ["    if (first_of(value) != '{')", "        return false;", "    c = inside(value);"]
        lines += ["    for (; more(&c, first); first = false) {", "        const slice_t raw = take_name(&c);"]
        lines += ["        const slice_t given = take(&c);", "        const dcp_text_t name = decode(raw);"]
        for index, member in enumerate(self.safety_data):
            lines.append(f'        {"} else if" if index else "if"} (is(name, "{member.name}")) {{')
            target = f"v->{member_name(member.name)}"
            if member.kind == "float":
                lines += ["            if (!read_real(given, &real))", "                return false;"]
                lines.append(f"            {target} = ({value_type(member)})real;")
            elif member.kind == "bytes":
                lines += [f"            if (!read_hex(given, false, &octets) || octets.size != {member.size}u)"]
                lines += ["                return false;", f"            {target} = octets.data;"]
            else:
                top, low = largest(member), "0" if not member.signed else f"-INT64_C({largest(member)}) - 1"
                beyond = f" || integer < {low}" + (f" || integer > INT64_C({top})" if member.size < 8 else "")
                lines += [f"            if (!read_integer(given, &integer){beyond})", "                return false;"]
                lines.append(f"            {target} = ({value_type(member)})integer;")
            lines.append(f"            seen |= UINT64_C({1 << index});")
        lines += ["        } else {", "            return false;", "        }", "    }"]
        lines += [f"    return seen == UINT64_C({(1 << len(self.safety_data)) - 1});", "}", ""]
        lines += ["void dcp_put_safety_data(dcp_out_t *out, const char *name, const dcp_safety_data_t *data)", "{"]
        lines.append("    dcp_begin_object(out, name);")
        for member in self.safety_data:
            value = f"data->{member_name(member.name)}"
            if member.kind == "float":
                lines.append(f'    dcp_put_real(out, "{member.name}", (double){value});')
            elif member.kind == "bytes":
                lines.append(f'    dcp_put_octets_hex(out, "{member.name}", {value}, {member.size}u);')
            else:
                function = "dcp_put_integer" if member.signed else "dcp_put_unsigned"
                lines.append(f'    {function}(out, "{member.name}", {value});')
        return "\n".join([*lines, "    dcp_end_object(out);", "}", "", ""])

    # -- notifications --------------------------------------------------------------------------------------------

    def _notification(self, name: str) -> tuple[str, list[tuple[str, str, bool]]]:
        """Return the signature of the function of a notification, and its members: name, kind, may be missing."""
        _, params = self._params(name)
        members = [
            (member, self._kind(member, schema), member not in params["required"])
            for member, schema in params["properties"].items()
        ]
        arguments = ["dcp_out_t *out"]
        for member, kind, optional in members:
            given = member_name(member)
            if kind in ("HEX", "NODE_ID"):
                arguments.append(f"const dcp_octets_t *{given}")
            elif kind == "TEXT":
                arguments.append(f"const char *{given}")
            else:
                assert not optional
                arguments.append(f"{_TYPES[kind]} {given}")
        return f"void dcp_notify_{_function(name.removesuffix('.indication'))}({', '.join(arguments)})", members

    def notification_signatures(self) -> list[str]:
        """Return the declarations of the notifications; what is NULL is left out."""
        return [self._notification(name)[0] for name in self.notices]

    def notifications(self) -> str:
        """Return the functions of the notifications."""
        lines: list[str] = []
        for name in self.notices:
            signature, members = self._notification(name)
            lines += [signature, "{", "    begin_message(out);", f'    dcp_put_text(out, "method", "{name}");']
            lines.append('    dcp_begin_object(out, "params");')
            for member, kind, optional in members:
                given = member_name(member)
                if kind in ("HEX", "NODE_ID"):
                    function = "dcp_put_octets_hex" if kind == "HEX" else "dcp_put_node_id"
                    lines += [f"    if ({given} != NULL)"] if optional else []
                    indent = "        " if optional else "    "
                    lines.append(f'{indent}{function}(out, "{member}", {given}->data, {given}->size);')
                else:
                    function = {"TEXT": "text", "INTEGER": "integer", "BOOLEAN": "boolean"}[kind]
                    lines.append(f'    dcp_put_{function}(out, "{member}", {given});')
            lines += ['    put_string(out, "}}");', "    end_line(out);", "}", ""]
        return "\n".join(lines)


def _function(method: str) -> str:
    return re.sub(r"_+", "_", snake_name(method))


_INCLUDES = """#include "dcp_adapter.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
"""
_NO_SAFETY = """static bool read_safety_data(slice_t value, void *to)
{
    (void)value;
    (void)to;
    return false;
}

"""
