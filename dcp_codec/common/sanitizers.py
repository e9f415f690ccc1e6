"""Reports of AddressSanitizer and its relatives in the output of a program: the fault, with the place in the source."""

from __future__ import annotations

import re
from collections.abc import Iterator

#: The first line of a report. It ends with registers, a process number or a colon, which do not describe the fault.
_REPORT = re.compile(r"(?:ERROR|WARNING): \w+Sanitizer: .*")
_REGISTERS = re.compile(r" (?:at pc|\(pc|\(pid=).*|:$")
_ACCESS = re.compile(r"(?:READ|WRITE) of size \d+|Direct leak of \d+ byte\(s\)")
#: A frame of a stack: ``#1 0x55d0 in parse /src/stack.c:7:5``; without symbols ``(/bin/stack+0x21d0)``.
_FRAME = re.compile(
    r"\s*#\d+ (?:0x[0-9a-fA-F]+ in )?(?P<function>\S.*?) (?P<place>\(?[^\s()]+(?::\d+|\+0x[0-9a-f]+\)))"
)
#: Sources of the sanitizer, of the C library and of headers: the fault is in the function that called them.
_NOT_OF_THE_USER = re.compile(
    r"libsanitizer|sanitizer_common|compiler-rt|/lib[acltu]+san\.|/libc[.-]|^\(?(?:\.\./sysdeps|/usr/(?:include|lib)/)"
)
#: UndefinedBehaviorSanitizer reports each fault in a line that has the place: ``stack.c:7:5: runtime error: ...``
_UNDEFINED = re.compile(r"\S+: runtime error: .*")
#: Number of faults that only UndefinedBehaviorSanitizer reports, and that are quoted.
_MOST = 3


def findings(output: str) -> list[str]:
    """Return the last report in an output, then faults that UndefinedBehaviorSanitizer reported, in one line each.

    A report gets the first frame of its stack in the user's source: ``ERROR: AddressSanitizer: heap-buffer-overflow on
    address 0x602000000018, WRITE of size 20, in parse /src/stack.c:7``. Its last lines do not have the place if a
    function of the C library noticed the fault.
    """
    lines = output.splitlines()
    beginnings = [place for place, line in enumerate(lines) if _REPORT.search(line)]
    found = [_report(lines[beginnings[-1] :])] if beginnings else []
    undefined = [match[0] for line in lines if (match := _UNDEFINED.search(line))]
    return found + list(dict.fromkeys(undefined))[-_MOST:]


def _report(lines: list[str]) -> str:
    first = _REPORT.search(lines[0])
    assert first is not None
    said = _REGISTERS.sub("", first[0])
    access = next((match[0] for line in lines[1:5] if (match := _ACCESS.search(line))), "")
    frames = list(_frames(lines))
    frame = next((each for each in frames if not _NOT_OF_THE_USER.search(each[1])), frames[0] if frames else None)
    return ", ".join(each for each in (said, access, f"in {' '.join(frame)}" if frame else "") if each)


def _frames(lines: list[str]) -> Iterator[tuple[str, str]]:
    """Yield functions and places of the first stack."""
    begun = False
    for line in lines:
        match = _FRAME.match(line)
        if match is not None:
            begun = True
            yield match["function"], match["place"]
        elif begun:
            return
