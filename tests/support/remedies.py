"""The contract's ``fix`` followed to the letter on a mission document, without any code of the product."""

from __future__ import annotations

import copy
from typing import Any


def remedies(fix: dict[str, Any] | None) -> list[dict[str, Any]]:
    """A fix and its alternatives, each on its own."""
    if fix is None:
        return []
    alone = {key: value for key, value in fix.items() if key != "alternatives"}
    return [alone, *fix.get("alternatives", [])]


def apply(document: dict[str, Any], fix: dict[str, Any]) -> dict[str, Any]:
    """The mission with one remedy, and what it names beside it, followed to the letter."""
    result = copy.deepcopy(document)
    for step in (fix, *fix.get("also", [])):
        result = apply_step(result, step)
    return result


def apply_step(result: dict[str, Any], fix: dict[str, Any]) -> dict[str, Any]:
    """``result`` with one step of a remedy, in place."""
    options, limits = result.setdefault("options", {}), result["limits"]
    stations = {s["id"]: s for s in result["stations"]}
    keys = ("east_m", "north_m", "up_m") if "origin" in result else ("lat_deg", "lon_deg", "alt_amsl_m")
    match fix["action"]:
        case "raise_range":
            stations[fix["station"]]["range_m"] += fix["by_m"]
        case "raise_all_ranges":
            for station in result["stations"]:
                station["range_m"] += fix["by_m"]
        case "lower_margin":
            options["range_margin_m"] = fix["range_margin_m"]
        case "lower_option":
            options[fix["option"]] = fix["to"]
        case "lower_elevation":
            stations[fix["station"]]["min_elevation_deg"] = fix["to_deg"]
        case "lower_elevations":
            for station in result["stations"]:
                angle = station.get("min_elevation_deg", 0.0) - fix["by_deg"]
                station["min_elevation_deg"] = angle if angle > 0.0 else None
        case "widen_band":
            limits |= {key: value for key, value in fix.items() if key.endswith("_alt_amsl_m")}
        case "set_altitude":
            result[fix["of"]][keys[2]] = fix["alt_amsl_m"] - result.get("origin", {}).get("alt_amsl_m", 0.0)
        case "move":
            result[fix["of"]] = {key: fix["position"][key] for key in keys}
        case "add_station":
            place = {key: fix["position"][key] for key in keys}
            name = "added"
            while name in stations:
                name += "-x"
            result["stations"].append({"id": name, "range_m": fix["range_m"], **place})
        case "include_station":
            options["excluded_stations"] = [s for s in options["excluded_stations"] if s != fix["station"]]
        case "raise_limit" if fix["limit"] == "max_handovers":
            options["max_handovers"] = fix["to"]
        case "raise_limit" | "lower_limit":
            limits[fix["limit"]] = fix["to"]
        case "lower_wind":
            limits["wind"] = {key: fix[key] for key in ("east_m_s", "north_m_s")}
        case "lower_start_speed":
            options["start_state"] = {key: fix[key] for key in ("velocity_m_s", "acceleration_m_s2")}
        case "later_arrival" | "earlier_arrival":
            options["arrival_s"] = fix["arrival_s"]
        case action:
            raise AssertionError(action)
    return result
