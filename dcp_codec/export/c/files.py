"""The two files of the generated codec."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from importlib import resources

from dcp_spec.reasons import REASONS
from dcp_spec.version import __version__

from dcp_codec.codec import Codec
from dcp_codec.export.shape import shape_of
from dcp_codec.export.wording import constant

from .header import Structures, constants, declarations, heading
from .reading import Reading
from .scalars import Scalars
from .writing import Writing

_ENUMERATOR = re.compile(r"\bDCP_((?:UWB|DATA|BP|SRP|VD)_(?:[A-Z]+_)*\d+)\b")


def codec_files(codec: Codec) -> dict[str, str]:
    """Return the files of the codec of a profile by name: ``dcp_codec.h`` and ``dcp_codec.c``.

    Raises ``ValueError`` if two members of a record would get the same name.
    """
    shape, scalars, shared = shape_of(codec), Scalars(), Scalars()
    reader, writer = Reading(shape, scalars, shared), Writing(shape, scalars, shared)
    body = f"{template('common.c')}\n{reader.all()}\n{template('common_writer.c')}\n{writer.all()}"
    inline = f"{template('common_inline.h')}\n{reader.inline()}\n{writer.inline()}"
    first = heading(codec.profile, __version__)
    identifiers = sorted(set(_ENUMERATOR.findall(body)))
    marks = {
        "COMMON": _common(identifiers),
        "CONSTANTS": "\n".join(constants(shape)),
        "STRUCTURES": Structures(shape, codec.profile).text(),
        "DECLARATIONS": declarations(shape).rstrip(),
        "INLINE": f"{shared.helpers()}\n{inline}".rstrip(),
    }
    header = header_file("DCP_CODEC", first, _INCLUDES, filled(_BODY, marks))
    requirements = ["", *(name.replace("_", "-") for name in identifiers)]
    names = f"{names_function('reason', ['ok', *REASONS])}\n{names_function('requirement', requirements)}"
    source = f'{first}\n#include "dcp_codec.h"\n\n{names}\n{scalars.helpers(shared)}\n{body}'
    return {"dcp_codec.h": header, "dcp_codec.c": source.rstrip() + "\n"}


def filled(text: str, marks: Mapping[str, str]) -> str:
    """Return a text with the marks ``@NAME@`` replaced."""
    for mark, value in marks.items():
        text = text.replace(f"@{mark}@", value)
    return text


def header_file(name: str, heading: str, includes: str, body: str) -> str:
    """Return the header ``name`` (in capitals, without suffix), which C++ can include, too."""
    return filled(_HEADER, {"HEADING": heading, "NAME": name, "INCLUDES": includes, "BODY": body})


def template(name: str) -> str:
    """Return a text that all profiles share."""
    return resources.files("dcp_codec.export.c").joinpath(name).read_text(encoding="utf-8")


def _common(identifiers: list[str]) -> str:
    width = max(len(constant(name)) for name in REASONS) + 1
    reasons = [f"    DCP_{'OK,'.ljust(width)} /* no problem */"]
    reasons += [f"    DCP_{(constant(name) + ',').ljust(width)} /* {meaning} */" for name, meaning in REASONS.items()]
    # C++ before 11 and pedantic compilers want no comma after the last one.
    reasons[-1] = reasons[-1].replace(",", " ", 1)
    requirements = ["    DCP_REQUIREMENT_NONE", *(f"    DCP_{name}" for name in identifiers)]
    marks = {"REASONS": "\n".join(reasons), "REQUIREMENTS": ",\n".join(requirements)}
    return filled(template("common.h"), marks).rstrip()


def names_function(of: str, names: Iterable[str]) -> str:
    """Return the function that names the enumerators of a type."""
    quoted = ",\n".join(f'        "{name}"' for name in names)
    return filled(_NAMES, {"OF": of, "NAMES": quoted})


_HEADER = """@HEADING@
#ifndef @NAME@_H
#define @NAME@_H

@INCLUDES@

#ifdef __cplusplus
extern "C" {
#endif

@BODY@

#ifdef __cplusplus
}
#endif

#endif
"""
_INCLUDES = """#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>"""
_BODY = """@COMMON@

@CONSTANTS@

@STRUCTURES@

@DECLARATIONS@

/* The names of a reason and of a requirement in the test kit: "zero-length", "BP-RX-03" ("": none). */
const char *dcp_reason_name(dcp_reason_t reason);
const char *dcp_requirement_name(dcp_requirement_t requirement);

/* Records of containers are read and added by functions that compilers can inline. */

@INLINE@"""
_NAMES = """const char *dcp_@OF@_name(dcp_@OF@_t @OF@)
{
    static const char *const names[] = {
@NAMES@
    };
    return (size_t)@OF@ < sizeof names / sizeof *names ? names[@OF@] : "";
}
"""
