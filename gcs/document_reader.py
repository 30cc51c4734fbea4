"""Reading documents at the door: every fault collected, each with its path, none of them raised half-way.

A `Reader` walks one JSON object. A field that is missing or wrong leaves a `gcs.errors.InputFault` in the shared list
and gives a harmless stand-in (NaN, empty text), so that reading goes on and the caller raises once at the end.
"""

from __future__ import annotations

import difflib
import json
import math
import re
import unicodedata
from collections.abc import Collection, Mapping, Sequence, Set

from gcs.errors import InputFault, MissionError

MAX_DOCUMENT_BYTES = 50_000_000
MAX_FAULTS = 200
_IDENTIFIER = re.compile(r"[^\W_][\w .\-:+#()'&]*")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")
_COMMA_IN_JSON = re.compile(r":\s*([+-]?\d+),(\d+)")
_XML = {"<kml": "KML", "<gpx": "GPX", "<mission": "an XML mission file", "<html": "a web page"}
# Scripts whose letters look like each other's.
_ALIKE = ("LATIN", "CYRILLIC", "GREEK", "ARMENIAN", "CHEROKEE", "COPTIC")


class FaultList(list[InputFault]):
    """Faults found so far; stops growing at `MAX_FAULTS`, so that garbage cannot make an endless answer."""

    def add(self, where: str, what: str, value: object = None, allowed: str = "", fix: str = "") -> None:
        """Note a fault."""
        if len(self) < MAX_FAULTS:
            self.append(InputFault(where, what, value, allowed, fix))


def type_name(value: object) -> str:
    """What a JSON value is, in JSON's words."""
    names: list[tuple[type, str]] = [
        (bool, "true or false"),
        (int, "a number"),
        (float, "a number"),
        (str, "text"),
        (list, "a list"),
        (dict, "an object"),
    ]
    return next((name for kind, name in names if isinstance(value, kind)), "null" if value is None else "no JSON value")


class Reader:
    """One JSON object at ``where``; ``fields`` are the names it may have.

    A value that is not an object is a fault, and reads as an empty one from which nothing is missed.
    """

    def __init__(self, value: object, where: str, faults: FaultList, fields: Collection[str]) -> None:
        self.where = where
        self.faults = faults
        self.ok = isinstance(value, dict | Mapping)
        self.data: Mapping[str, object] = value if isinstance(value, dict | Mapping) else {}
        if not self.ok:
            known = sorted(fields)
            some = ", ".join(known[:4]) + (", ..." if len(known) > 4 else "")
            what, fix = f"must be an object, not {type_name(value)}", f"put it in braces, with {some}"
            faults.add(where or "mission", what, value, "a JSON object", fix)
        if not self.data.keys() <= (fields if isinstance(fields, Set) else frozenset(fields)):
            for key in self.data:
                if key not in fields:
                    self._unknown(key, fields)

    def _unknown(self, key: object, fields: Collection[str]) -> None:
        # The same word with another unit first: alt_ft is meant to be alt_amsl_m.
        stem = str(key).partition("_")[0]
        close = [field for field in fields if field.partition("_")[0] == stem]
        if len(close) != 1:
            close = difflib.get_close_matches(str(key), list(fields), n=1, cutoff=0.6)
        fix = f"did you mean {close[0]}?" if close else "remove it"
        shown = str(key) if printable(str(key)) and len(str(key)) <= 64 else "?"
        self.faults.add(self.path(shown), "is not a known field", self.data[key], ", ".join(sorted(fields)), fix)  # type: ignore[index]

    def path(self, key: str) -> str:
        """The path of one of this object's fields."""
        return f"{self.where}.{key}" if self.where else key

    def has(self, key: str) -> bool:
        """Whether the field is there; null counts as absent."""
        return self.data.get(key) is not None

    def fault(self, key: str, what: str, allowed: str = "", fix: str = "", *, value: object = None) -> None:
        """Note a fault of a field, with its value."""
        self.faults.add(self.path(key), what, self.data.get(key) if value is None else value, allowed, fix)

    def _missing(self, key: str, allowed: str) -> None:
        if self.ok:
            self.faults.add(self.path(key), "is missing", None, allowed, "add it")

    def number(
        self,
        key: str,
        low: float,
        high: float,
        unit: str,
        *,
        above_low: bool = False,
        default: float | None = None,
    ) -> float:
        """A finite number in [low, high] (or above ``low``); missing without default is a fault. NaN after a fault."""
        if not self.has(key):
            if default is None:
                self._missing(key, _span(low, high, unit, above_low))
                return math.nan
            return default
        value = self.data[key]
        if isinstance(value, bool) or not isinstance(value, int | float):
            span = _span(low, high, unit, above_low)
            self.fault(key, f"must be a number, not {type_name(value)}", span, _bare(value, unit))
            return math.nan
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            span = _span(low, high, unit, above_low)
            self.fault(key, "must be a finite number", span, "give one within that span", value=str(number))
            return math.nan
        if number > high or number < low or (above_low and number == low):
            if number > high:
                what = "is too large"
            elif number < 0 <= low:
                what = "must not be negative"
            elif above_low and number == low == 0:
                what = "must not be zero"
            else:
                what = "is too small"
            fix = f"give one within that span, in {unit}"
            if key == "lon_deg" and 180.0 < abs(number) <= 360.0:
                fix = f"write {number - math.copysign(360.0, number):.10g}"
            self.fault(key, what, _span(low, high, unit, above_low), fix)
            return math.nan
        return number

    def optional_number(self, key: str, low: float, high: float, unit: str, *, above_low: bool = False) -> float | None:
        """As `number`, None when absent."""
        return self.number(key, low, high, unit, above_low=above_low) if self.has(key) else None

    def integer(self, key: str, low: int, high: int, *, default: int | None) -> int | None:
        """A whole number in [low, high]; ``default`` when absent and after a fault."""
        if not self.has(key):
            return default
        value, allowed = self.data[key], f"a whole number from {low} to {high}"
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int):
            kind = "" if isinstance(value, float) else f", not {type_name(value)}"
            self.fault(key, f"must be a whole number{kind}", allowed, "give a whole number without quotes")
        elif not low <= value <= high:
            self.fault(key, "is out of range", allowed, "give one within that range")
        else:
            return value
        return default

    def text(self, key: str, longest: int, *, default: str | None = None, required: bool = False) -> str | None:
        """Printable text of 1 to ``longest`` characters, without blanks at its ends; ``default`` when absent."""
        if not self.has(key):
            if required:
                self._missing(key, f"1 to {longest} printable characters")
            return default
        value = self.data[key]
        if isinstance(value, str) and len(value) <= longest and value.isprintable() and value == value.strip() != "":
            return value
        allowed = f"1 to {longest} printable characters"
        if not isinstance(value, str):
            self.fault(key, f"must be text, not {type_name(value)}", allowed, "write it in quotes")
        elif len(value) > longest:
            self.fault(key, f"has {len(value)} characters", allowed, "shorten it")
        elif not value.strip():
            self.fault(key, "is empty", allowed, "give it a text, or leave it out where it is not required")
        elif value != value.strip():
            self.fault(key, "begins or ends with blanks", allowed, "remove them")
        elif not printable(value):
            self.fault(key, "holds control or invisible characters", allowed, "remove them")
        else:
            return value
        return default

    def identifier(self, key: str) -> str:
        """An id: letters and digits of any script and ``. _ - : + # ( ) ' &`` and blanks, beginning with a letter or
        digit.

        No ``=``, ``/``, comma or quote: ids stand in ``--link ID=URL``, in addresses, file names and CSV.
        """
        value = self.text(key, 64, required=True)
        if value is None:
            return ""
        # An accent may be written as a sign of its own: the same letter to everybody but a computer.
        value = unicodedata.normalize("NFC", value)
        scripts = {unicodedata.name(c, "").partition(" ")[0] for c in value if c.isalpha()}
        mixed = [script.capitalize() for script in _ALIKE if script in scripts]
        if len(mixed) > 1:
            what = f"mixes {' and '.join(mixed)} letters, some of which look the same"
            self.fault(key, what, "letters of one script", "write it with letters of one")
        if not _IDENTIFIER.fullmatch(value):
            self.fault(
                key,
                "is not a usable id",
                "up to 64 letters, digits, blanks and . _ - : + # ( ) ' &, beginning with a letter or digit",
                "write it with those; its name may hold any printable text",
            )
        return value

    def choice(self, key: str, choices: Sequence[str], default: str) -> str:
        """One of a few words."""
        if not self.has(key):
            return default
        value = self.data[key]
        if value not in choices or not isinstance(value, str):
            close = difflib.get_close_matches(str(value), choices, n=1)
            fix = f"did you mean {close[0]}?" if close else f"choose one of them; {default} is the default"
            self.fault(key, "is not one of the choices", " or ".join(choices), fix)
            return default
        return value

    def items(self, key: str, most: int, *, required: bool = False) -> list[object]:
        """A list of at most ``most`` items; empty when absent or wrong."""
        if not self.has(key):
            if required:
                self._missing(key, "a list")
            return []
        value = self.data[key]
        if not isinstance(value, list | tuple):
            self.fault(key, f"must be a list, not {type_name(value)}", "a list", "put it in square brackets")
            return []
        if len(value) > most:
            self.faults.add(self.path(key), f"has {len(value)} items", None, f"at most {most} items", "leave some out")
            return []
        return list(value)

    def child(self, key: str, fields: Collection[str]) -> Reader:
        """The object in a field; a fault when missing."""
        if not self.has(key):
            self._missing(key, "an object with " + ", ".join(sorted(fields)))
            missing = Reader({}, self.path(key), FaultList(), fields)
            missing.ok = False
            return missing
        return Reader(self.data[key], self.path(key), self.faults, fields)


def _bare(value: object, unit: str) -> str:
    """What to do about text where a number is wanted."""
    if isinstance(value, str):
        try:
            number = float(value.strip())
        except ValueError:
            if _DECIMAL_COMMA.fullmatch(value.strip()):
                return f"write {value.strip().replace(',', '.')}: a decimal point, without quotes"
            return f"give a plain number, in {unit}, without quotes"
        if math.isfinite(number):
            return f"write {number:.15g} without quotes"
    return f"give a plain number, in {unit}"


def _span(low: float, high: float, unit: str, above_low: bool) -> str:
    """What a number may be, in words."""
    if above_low:
        return f"more than {low:.10g} up to {high:.10g} {unit}"
    return f"from {low:.10g} to {high:.10g} {unit}"


def printable(text: str) -> bool:
    """No control, format, surrogate, private or unassigned character, and no line or paragraph separator."""
    return not any(unicodedata.category(c) in {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"} for c in text)


def parse_json(data: bytes | str, *, max_bytes: int = MAX_DOCUMENT_BYTES) -> object:
    """Strict JSON (RFC 8259): no NaN or Infinity, no key twice, valid UTF-8, bounded size and depth.

    Raises `MissionError` with one fault that names the line or the key.
    """
    raw = data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data
    if len(raw) > max_bytes:
        fix = "leave out what the mission does not need"
        raise MissionError([InputFault("mission", f"has {len(raw)} bytes", None, f"at most {max_bytes} bytes", fix)])
    if raw.startswith(b"PK\x03\x04"):
        fix = "unpack it, and write what it holds as a mission in JSON"
        raise MissionError([InputFault("mission", "is a zip archive (KMZ, perhaps)", None, "JSON in UTF-8", fix)])
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        what = f"is not valid UTF-8 at byte {error.start}"
        raise MissionError([InputFault("mission", what, None, "JSON in UTF-8", "save it as UTF-8")]) from None
    if not text.strip():
        raise MissionError([InputFault("mission", "is empty", None, "a JSON object", "write the document into it")])
    try:
        return json.loads(text, parse_constant=_no_constant, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        raise MissionError([_not_json(text, error)]) from None
    except RecursionError:
        fix = "remove the brackets that hold nothing"
        raise MissionError([InputFault("mission", "is nested too deep", None, "objects as documented", fix)]) from None
    except _BadJsonError as error:
        raise MissionError([error.fault]) from None
    except ValueError:  # an integer of thousands of digits
        what, allowed = "holds a whole number of thousands of digits", "numbers of up to 4300 digits"
        raise MissionError([InputFault("mission", what, None, allowed, "write a number that is meant")]) from None


def _not_json(text: str, error: json.JSONDecodeError) -> InputFault:
    """What is wrong with text that is no JSON: another program's file, a decimal comma, or a slip at a place."""
    other = _other_format(text)
    if other is not None:
        fix = "write what it holds as a mission in JSON: start, destination, stations, limits"
        return InputFault("mission", f"is {other}, not JSON", None, "a JSON object", fix)
    where = f"line {error.lineno}, column {error.colno}"
    line = text.splitlines()[error.lineno - 1] if error.lineno <= len(text.splitlines()) else ""
    comma = _COMMA_IN_JSON.search(line)
    if comma is not None:
        what = f"holds a number with a decimal comma, {comma[1]},{comma[2]}, at line {error.lineno}"
        fix = f"write {comma[1]}.{comma[2]}, with a point"
        return InputFault("mission", what, None, "numbers with a decimal point", fix)
    return InputFault(
        "mission", f"is not valid JSON: {error.msg} at {where}", None, "a JSON object", "correct the text there"
    )


def _other_format(text: str) -> str | None:
    """The kind of file that a text is, where it is a well-known other one."""
    head = text.lstrip()[:4_000]
    if head.startswith("QGC WPL"):
        return "a waypoint file (QGC WPL)"
    if head.startswith("<"):
        for sign, name in _XML.items():
            if sign in head.lower():
                return name
        return "XML"
    lines = head.splitlines()
    plain = bool(lines) and not any(sign in lines[0] for sign in '{}[]"') and lines[0].strip()[:1].isalpha()
    for mark in (",", ";", "\t"):
        if plain and len(lines) > 1 and lines[0].count(mark) >= 2 and lines[1].count(mark) == lines[0].count(mark):
            return "a table (CSV)"
    return None


class _BadJsonError(Exception):
    def __init__(self, fault: InputFault) -> None:
        super().__init__(str(fault))
        self.fault = fault


def _no_constant(name: str) -> object:
    raise _BadJsonError(
        InputFault("mission", f"holds {name}, which is not JSON", name, "finite numbers", "give a number")
    )


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    result: dict[str, object] = {}
    for key, value in pairs:
        if key in result:
            shown = key if printable(key) and len(key) <= 64 else "?"
            raise _BadJsonError(InputFault(shown, "stands twice in one object", None, "each field once", "remove one"))
        result[key] = value
    return result
