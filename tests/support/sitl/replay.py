"""Replays what the stations of a recording sent against the simulator's core, in virtual time."""

from __future__ import annotations

import difflib
import hashlib
import math
import re
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.ardupilot.parameters import ARDUPILOT
from sitl_fixtures.px4.parameters import PX4
from sitl_fixtures.vehicle import SimulatedAutopilot, SimulatorConfig
from tests.support.link.recordings import load

BOOT_S = {"ArduCopter": 0.06, "PX4": 0.37}
READY_S = {"ArduCopter": 41.4, "PX4": 3.9}
KEYS = {name: hashlib.sha256(b"golden recording key " + name.encode()).digest() for name in "AB"}


@dataclass(frozen=True)
class Heard:
    """A message from the vehicle, recorded or simulated."""

    t: float
    link: str
    name: str
    fields: dict[str, Any]


@dataclass
class Recording:
    """A recorded conversation."""

    header: dict[str, Any]
    sent: list[dict[str, Any]]
    heard: list[Heard]

    @property
    def ardupilot(self) -> bool:
        return bool(self.header["autopilot"] == "ArduCopter")

    def mark(self, text: str) -> float:
        """Time of the first mark that starts with a text."""
        for t, words in self.header["marks"]:
            if words.startswith(text):
                return float(t)
        raise KeyError(text)


@lru_cache(maxsize=2)
def read_recording(name: str) -> Recording:
    """Reads a recording by its file name without suffixes."""
    header, messages = load(name)
    heard = [Heard(m["t"], m["link"], m["msg"], m["fields"]) for m in messages if m["dir"] == "rx"]
    return Recording(header, [m for m in messages if m["dir"] == "tx"], heard)


def to_message(entry: dict[str, Any]) -> Any:
    """A recorded message as one that can be packed."""
    make = getattr(mavlink, f"MAVLink_{entry['msg'].lower()}_message")
    values: dict[str, Any] = {}
    for name, value in entry["fields"].items():
        if name == "int_value":
            continue
        if value is None:
            value = math.nan
        elif value in ("inf", "-inf"):
            value = float(value)
        elif name in ("param_id", "passkey"):
            value = value.encode()
        elif name == "secret_key" and isinstance(value, str):
            value = [0] * 32 if value == "zeros" else list(KEYS["B" if "key B" in value else "A"])
        values[name] = value
    if "int_value" in entry["fields"] and entry["fields"]["param_type"] == 6:
        values["param_value"] = struct.unpack("<f", struct.pack("<i", entry["fields"]["int_value"]))[0]
    return make(**values)


class Replay:
    """The simulator fed with what the stations of a recording sent.

    Attributes:
        heard: what the simulated vehicle sent, on the recording's clock.
        path: (t, north, east, down, vn, ve, vd, mode) of the estimate, 20 Hz.
    """

    def __init__(
        self,
        recording: Recording,
        *,
        parameters: Iterable[str] = (),
        key_of: Callable[[dict[str, Any]], bytes] | None = None,
        config: dict[str, Any] | None = None,
    ) -> None:
        self.recording = recording
        header = recording.header
        self.links = sorted(header["links"])
        origin = header["origin"]
        autopilot = header["autopilot"]
        own = {name for name, *_ in (_table(autopilot))}
        given = [
            f"{name}={value}"
            for name, value in header["parameters"].items()
            if name in own and value is not None and not isinstance(value, dict)
        ]
        self.sim = SimulatedAutopilot(
            SimulatorConfig(
                autopilot="ardupilot" if recording.ardupilot else "px4",
                home=(origin["lat_deg"], origin["lon_deg"], origin["alt_amsl_m"]),
                links=len(self.links),
                parameters=(*given, *parameters),
                ready_after_s=READY_S[autopilot],
                **(config or {}),
            )
        )
        self._key_of = key_of
        self._senders: dict[tuple[str, int, int], Any] = {}
        self._parsers = [mavlink.MAVLink(None, 0, 0) for _ in self.links]
        for parser in self._parsers:
            parser.robust_parsing = True
        self.heard: list[Heard] = []
        self.path: list[tuple[float, ...]] = []
        self.modes: list[tuple[float, str]] = []

    def run(self, until_s: float = math.inf, stamps: Callable[[dict[str, Any]], int] | None = None) -> Replay:
        """Feeds everything sent up to a time."""
        sim = self.sim
        now = BOOT_S[self.recording.header["autopilot"]]
        sim.step(now)
        next_sample = now
        end = min(until_s, float(self.recording.header["duration_s"]))
        queue = [entry for entry in self.recording.sent if entry["t"] <= end]
        position = 0
        while now < end:
            due = queue[position]["t"] if position < len(queue) else end
            while next_sample < due:
                now = next_sample
                sim.step(now)
                self._collect(now)
                e, b = sim.estimator, sim.body
                self.path.append((now, e.n, e.e, e.d, b.vn, b.ve, b.vd))
                name = sim.autopilot.mode_name
                if not self.modes or self.modes[-1][1] != name:
                    self.modes.append((now, name))
                next_sample += 0.05
            now = max(now, due)
            if position < len(queue):
                self._send(queue[position], now, stamps)
                position += 1
        return self

    def _send(self, entry: dict[str, Any], now: float, stamps: Callable[[dict[str, Any]], int] | None) -> None:
        sender = (entry["link"], *entry["src"])
        mav = self._senders.setdefault(sender, mavlink.MAVLink(None, *entry["src"]))
        mav.signing.sign_outgoing = "signed" in entry
        if "signed" in entry:
            assert self._key_of is not None
            mav.signing.secret_key = self._key_of(entry)
            mav.signing.link_id = entry["signed"]["link_id"]
            mav.signing.timestamp = entry["signed"]["timestamp"] if stamps is None else stamps(entry)
        data = to_message(entry).pack(mav)
        mav.seq = (mav.seq + 1) % 256
        self.sim.receive(self.links.index(entry["link"]), data, now)
        self._collect(now)

    def _collect(self, now: float) -> None:
        for index, data in self.sim.take_outgoing():
            for message in self._parsers[index].parse_buffer(data) or []:
                fields = message.to_dict()
                fields.pop("mavpackettype")
                if data[2] & 1:
                    fields["signed"] = (data[-13], int.from_bytes(data[-12:-6], "little"))
                self.heard.append(Heard(now, self.links[index], message.get_type(), fields))

    def at(self, t: float) -> tuple[float, ...]:
        """The sample of the path nearest to a time."""
        return min(self.path, key=lambda sample: abs(sample[0] - t))


def _table(autopilot: str) -> list[tuple[str, float, int]]:
    return ARDUPILOT if autopilot == "ArduCopter" else PX4


# Texts that belong to sensors, logs and start-up, not to the conversation.
NOISE = (
    "Barometer",
    "EKF3",
    "AHRS",
    "ArduPilot Ready",
    "RC7",
    "GPS 1:",
    "Field Elevation",
    "[logger]",
    "SIM Hit",
    "PreArm",
)
NOISE_PARAMETERS = ("STAT_", "BARO", "INS_", "CAL_", "MOT_THST", "COM_RC_LOSS_T", "EKF2_", "SENS_", "SYS_AUTO", "LND_")


@dataclass
class Answers:
    """Answers of one side, reduced to what counts."""

    lines: list[tuple[float, str, str]] = field(default_factory=list)

    @classmethod
    def of(cls, heard: Iterable[Heard], kinds: set[str]) -> Answers:
        """(t, link, words) of every message of some kinds; texts that came in pieces are joined."""
        made = cls()
        pieces: dict[tuple[str, int], str] = {}
        for h in heard:
            if h.name not in kinds:
                continue
            f = h.fields
            words = h.name
            if h.name == "COMMAND_ACK":
                words = f"ACK {f['command']} {f['result']} to {f['target_system']}/{f['target_component']}"
            elif h.name == "STATUSTEXT":
                text = str(f["text"])
                if text.startswith(NOISE):
                    continue
                if len(text) == 50:
                    pieces[h.link, f["id"]] = text
                    continue
                whole = re.sub(
                    r"(RTL: start return) at.*", r"\1", f"{pieces.pop((h.link, f['id']), '')}{text}".rstrip("\t")
                )
                words = f"TEXT {f['severity']} {whole}"
            elif h.name == "PARAM_VALUE":
                if str(f["param_id"]).startswith(NOISE_PARAMETERS):
                    continue
                value = f["param_value"]
                shown = "nan" if value is None or value != value else f"{value:.6g}"
                words = f"PARAM {f['param_id']} {shown} type {f['param_type']}"
            elif h.name in ("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_COUNT", "MISSION_ACK"):
                number = f.get("seq", f.get("count", f.get("type")))
                words = f"{h.name} {number} to {f['target_system']}"
            elif h.name in ("MISSION_ITEM_INT", "MISSION_ITEM"):
                words = f"{h.name} {f['seq']} {f['command']} frame {f['frame']} {f['x']} {f['y']} {f['z']:.1f}"
            elif h.name == "HEARTBEAT":
                if f["type"] != 2:
                    continue
                words = f"BEAT mode {f['custom_mode']} base {f['base_mode']} status {f['system_status']}"
            made.lines.append((h.t, h.link, words))
        return made

    def between(self, start: float, end: float, link: str | None = None) -> list[tuple[float, str]]:
        """(t, words) in a span, on one link or all."""
        return [(t, words) for t, at, words in self.lines if start <= t < end and link in (None, at)]


@dataclass
class Comparison:
    """What one link of a recording and of its replay do not share.

    Attributes:
        missing: answers only the real autopilot gave, (t, words).
        extra: answers only the simulator gave.
        shifts: for each shared answer, simulator's time minus the real one's, (seconds, t, words).
    """

    missing: list[tuple[float, str]]
    extra: list[tuple[float, str]]
    shifts: list[tuple[float, float, str]]


def compare(recording: Recording, replay: Replay, link: str, kinds: set[str], since_s: float = 0.0) -> Comparison:
    """Lays the answers on a link from a time on side by side, in order."""
    real = Answers.of(recording.heard, kinds).between(since_s, math.inf, link)
    ours = Answers.of(replay.heard, kinds).between(since_s, math.inf, link)
    matcher = difflib.SequenceMatcher(None, [w for _, w in real], [w for _, w in ours], autojunk=False)
    found = Comparison([], [], [])
    for kind, i, j, k, m in matcher.get_opcodes():
        if kind == "equal":
            found.shifts += [(ours[k + n][0] - real[i + n][0], *real[i + n]) for n in range(j - i)]
        else:
            found.missing += real[i:j]
            found.extra += ours[k:m]
    return found
