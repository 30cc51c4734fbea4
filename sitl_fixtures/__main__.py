"""``python -m sitl_fixtures``: the simulated autopilot as a process."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence

from sitl_fixtures.errors import ConfigurationError, SimulatorError
from sitl_fixtures.faults.injection import listing
from sitl_fixtures.process.host import Address, run_process
from sitl_fixtures.vehicle.config import SimulatorConfig
from sitl_fixtures.vehicle.vehicle import SimulatedAutopilot


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser(prog="sitl_fixtures", description="A simulated PX4 or ArduPilot speaking MAVLink.")
    made.add_argument("--autopilot", choices=["px4", "ardupilot"], default="px4")
    made.add_argument("--listen", action="append", metavar="udpin:HOST:PORT", help="a link; may be given several times")
    made.add_argument("--home", metavar="LAT,LON,ALT", help="degrees and metres AMSL of the ground")
    made.add_argument("--speedup", type=float, default=1.0, help="vehicle seconds a wall second")
    made.add_argument("--param", action="append", default=[], metavar="NAME=VALUE")
    made.add_argument("--fault", action="append", default=[], metavar="NAME[:ARG][@START[+FOR]]")
    made.add_argument("--list-faults", action="store_true")
    made.add_argument("--seed", type=int, default=0)
    made.add_argument("--system-id", type=int, default=1)
    made.add_argument("--uid", default="", metavar="HEX", help="the board's unique id; none: it tells none")
    made.add_argument("--ready-after", type=float, default=2.0, metavar="S", help="vehicle seconds to a position")
    made.add_argument("--max-speed", type=float, metavar="M_S", help="top speed in level flight; sets the drag")
    made.add_argument("--tilt", type=float, metavar="DEG", help="largest lean, instead of the parameter's")
    made.add_argument("--wind", metavar="NORTH,EAST", help="velocity of the air, m/s")
    made.add_argument("--firmware", default="", metavar="4.6", help="ArduCopter's older names for whom it hears")
    made.add_argument("--speaks-operator-control", action="store_true", help="CONTROL_STATUS and command 32100")
    made.add_argument("--duration", type=float, metavar="S", help="wall seconds to run; default: until stopped")
    return made


def numbers(where: str, text: str | None, count: int) -> tuple[float, ...] | None:
    """``count`` comma-separated numbers; None stays None."""
    if text is None:
        return None
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count:
        raise ConfigurationError(where, text, f"{count} numbers separated by commas", "correct it")
    return values


def with_negative_values(arguments: Sequence[str]) -> list[str]:
    """``--home -35.3,149.1,584`` as ``--home=-35.3,...``: argparse takes numbers with a minus for an option."""
    joined: list[str] = []
    for argument in arguments:
        if joined and re.match(r"-[\d.]", argument) and joined[-1].startswith("--") and "=" not in joined[-1]:
            joined[-1] += "=" + argument
        else:
            joined.append(argument)
    return joined


def main(arguments: list[str] | None = None) -> int:
    """Runs the simulator; the exit code is 2 for options that cannot be used."""
    options = parser().parse_args(with_negative_values(sys.argv[1:] if arguments is None else arguments))
    if options.list_faults:
        sys.stdout.write(listing() + "\n")
        return 0
    try:
        home = numbers("--home", options.home, 3)
        wind = numbers("--wind", options.wind, 2) or (0.0, 0.0)
        addresses = [Address.parse(text) for text in options.listen or ["udpin:127.0.0.1:14540"]]
        config = SimulatorConfig(
            autopilot=options.autopilot,
            home=(home[0], home[1], home[2]) if home else None,
            links=len(addresses),
            system_id=options.system_id,
            uid=options.uid,
            speedup=options.speedup,
            parameters=tuple(options.param),
            faults=tuple(options.fault),
            seed=options.seed,
            ready_after_s=options.ready_after,
            tick_s=0.01 if options.speedup <= 10.0 else 0.02,
            max_speed_m_s=options.max_speed,
            tilt_deg=options.tilt,
            wind_n_m_s=wind[0],
            wind_e_m_s=wind[1],
            firmware=options.firmware,
            speaks_operator_control=options.speaks_operator_control,
            setpoint_log=2,
        )
        return run_process(SimulatedAutopilot(config), addresses, options.speedup, options.duration)
    except SimulatorError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2


if __name__ == "__main__":
    sys.exit(main())
