"""Text form of impairments (``loss=0.1,delay=5ms``), and the table form (TOML, JSON) with the same keys."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Final, get_args

from .parameters import Distribution, Impairment, ImpairmentError, Outage

_UNITS: Final[Mapping[str, int]] = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}
_TIME: Final = re.compile(r"(\d{1,12}(?:\.\d{1,12})?|\.\d{1,12})(ns|us|ms|s)")
_OUTAGE: Final = re.compile(r"(?P<start>[^+/]+)\+(?P<duration>[^+/]+)(?:/(?P<period>[^+/]+))?")
_NUMBERS: Final = ("loss", "burst", "p", "r", "bad", "duplicate", "reorder", "corrupt", "corrupt_frames")
_TIMES: Final = ("delay", "jitter", "reorder_delay")
_DISTRIBUTIONS: Final = get_args(Distribution)
KEYS: Final = (*_NUMBERS, *_TIMES, "distribution", "flips", "down")


def parse_impairment(text: str) -> Impairment:
    """Parse ``KEY=VALUE,KEY=VALUE``; the empty text is a perfect link.

    Times have a unit: ``ns``, ``us``, ``ms`` or ``s``. ``down=START+DURATION`` and ``down=START+DURATION/PERIOD`` may
    be given several times. Raises ``ImpairmentError`` with the key and the reason.
    """
    found: dict[str, Any] = {}
    for part in filter(None, (each.strip() for each in text.split(","))):
        key, equals, value = (each.strip() for each in part.partition("="))
        if not equals or not value:
            raise ImpairmentError(f"{key or part}: a value is missing; write {key or 'loss'}=VALUE")
        if key == "down":
            found.setdefault("down", []).append(value)
        elif key in found:
            raise ImpairmentError(f"{key}: the key is given twice")
        else:
            found[key] = value
    return impairment_of(found)


def impairment_of(table: Mapping[str, Any]) -> Impairment:
    """Return the impairment of a table with the keys of the text form: shares as numbers, times as text with a unit.

    Raises ``ImpairmentError`` with the key and the reason.
    """
    return Impairment(**{key: _value(key, value) for key, value in table.items()})


def text_of(impairment: Impairment) -> str:
    """Return the text form, without keys that have their default value."""
    parts, usual = [], Impairment()
    for key in KEYS:
        value = getattr(impairment, key)
        if value == getattr(usual, key):
            continue
        if key == "down":
            parts += [f"down={_outage_text(each)}" for each in value]
        elif key in _TIMES:
            parts.append(f"{key}={_time_text(value)}")
        else:
            parts.append(f"{key}={value!r}" if isinstance(value, float) else f"{key}={value}")
    return ",".join(parts)


def _value(key: str, value: Any) -> Any:
    if key in _NUMBERS:
        return _number(key, value)
    if key in _TIMES:
        return _time(key, value)
    if key == "distribution":
        if value not in _DISTRIBUTIONS:
            raise ImpairmentError(f"distribution: {value!r} is not one of {', '.join(_DISTRIBUTIONS)}")
        return value
    if key == "flips":
        number = _number(key, value)
        if number != int(number):
            raise ImpairmentError(f"flips: {value} is not an integer")
        return int(number)
    if key == "down":
        return tuple(map(_outage, value if isinstance(value, list | tuple) else [value]))
    raise ImpairmentError(f"{key}: unknown key; the keys are {', '.join(KEYS)}")


def _number(key: str, value: Any) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise ImpairmentError(f"{key}: {value!r} is not a number")
    return number


def _time(key: str, value: Any) -> int:
    match = _TIME.fullmatch(value.strip()) if isinstance(value, str) else None
    if match is None:
        raise ImpairmentError(f"{key}: {value!r} is not a time; write a number and its unit, such as 5ms, 300us or 1s")
    return round(float(match[1]) * _UNITS[match[2]])


def _outage(value: Any) -> Outage:
    match = _OUTAGE.fullmatch(value.strip()) if isinstance(value, str) else None
    if match is None:
        form = "START+DURATION or START+DURATION/PERIOD, such as 10s+5s/30s"
        raise ImpairmentError(f"down: {value!r} is not an outage; write {form}")
    period = _time("down", match["period"]) if match["period"] else 0
    return Outage(_time("down", match["start"]), _time("down", match["duration"]), period)


def _outage_text(outage: Outage) -> str:
    period = f"/{_time_text(outage.period)}" if outage.period else ""
    return f"{_time_text(outage.start)}+{_time_text(outage.duration)}{period}"


def _time_text(time: int) -> str:
    unit = next((name for name in ("s", "ms", "us") if time % _UNITS[name] == 0), "ns")
    return f"{time // _UNITS[unit]}{unit}"
