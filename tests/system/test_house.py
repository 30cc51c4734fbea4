"""The house keeps its shape: who imports whom, what each room shows, sizes, packaging, and nothing of one machine.

The rules are the tables below; `tests.support.house` reads the syntax trees, and ``test_house_offences.py`` shows of
each check that it fails where it should.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest

from tests.support.house import checks, texts
from tests.support.house.modules import House
from tests.support.paths import ROOT

# Each package and those of ours it may import: api -> link -> gcs -> planner, the simulator on its own.
ALLOWED = {
    "planner": (),
    "gcs": ("planner",),
    "link": ("gcs", "planner"),
    "api": ("link", "gcs", "planner"),
    "sitl_fixtures": (),
}
GENERATED = ("link/dialect/skyrelay.py",)

BANNED = {
    "planner": ("pymavlink", "fastapi", "sqlalchemy", "socket", "datetime", "pydantic", "json", "pathlib"),
    "gcs": ("pymavlink", "fastapi", "uvicorn", "starlette"),
    "link": ("fastapi", "sqlalchemy", "uvicorn", "starlette"),
    "sitl_fixtures": ("fastapi", "sqlalchemy", "uvicorn", "starlette"),
}
"""Libraries a package has no business with: the planner does no I/O and knows no clock, only `api` speaks HTTP."""

LEVELS = {
    "planner": (
        ("errors", "arrays", "remedy", "bezier", "problem", "airspeed", "trajectory", "speed_profile"),
        ("coverage",),
        ("certificate", "energy", "solution", "infeasibility"),
        ("routing", "corridor"),
        ("paper", "joint"),
        ("experiments", "planner"),
    ),
    "gcs": (
        ("errors", "timestamps", "flight", "settings", "geodesy"),
        ("document_reader", "operator_commands", "store"),
        ("mission",),
        ("layout",),
        ("plan", "remedies"),
        ("exports", "planning"),
        ("jobs",),
    ),
    "link": (
        ("errors", "clock", "dialect", "setpoints"),
        ("wire", "transport"),
        ("microservices",),
        ("autopilot",),
        ("telemetry",),
        ("session", "files"),
        ("handover",),
        ("monitors", "preflight"),
        ("director",),
        ("streamer",),
    ),
    "api": (("service", "processes"), ("rest", "bench"), ("cli",)),
    "sitl_fixtures": (
        ("errors", "vehicle_protocol", "dynamics"),
        ("mavlink",),
        ("autopilot", "faults"),
        ("px4", "ardupilot"),
        ("vehicle",),
        ("process",),
        ("__main__",),
    ),
}
"""Rooms, lower levels first: a room imports those before it, and those beside it as long as no circle comes of it."""
APART = (("sitl_fixtures.px4", "sitl_fixtures.ardupilot"),)

PUBLIC_MODULES = (
    "planner.arrays",
    "planner.bezier",
    "planner.remedy",
    "gcs.document_reader",
    "gcs.errors",
    "gcs.flight",
    "gcs.operator_commands",
    "gcs.settings",
    "gcs.timestamps",
    "link.clock",
    "link.errors",
)
"""What another package may import beside the faces of packages and rooms."""

SURFACE = {
    "planner": (
        "Certificate Corridor Infeasibility InfeasibleError Limits LowerBound Method Piece Planner PlannerError "
        "Problem ProblemError Solution SolverError Trajectory build_corridor certify lower_bound"
    ),
    "planner.corridor": "build_corridor polyline_length_m shortest_polyline",
    "planner.coverage": "ElevationMask Stations adjacent_pairs coverage_windows disc_radius_m",
    "planner.experiments": "Evaluation enumerate_plans plan_by_rival plan_paper_cvxpy",
    "planner.infeasibility": "diagnose diagnose_ranges infeasibility_of remedied",
    "planner.joint": "Effort plan_joint",
    "planner.paper": "Iteration plan_paper shortest_sequence",
    "planner.routing": "candidate_routes lower_bound",
    "gcs.exports": "FORMATS export_handovers parse_launch summary umask write_atomic",
    "gcs.geodesy": "WGS84_A_M WGS84_E2 Plane",
    "gcs.jobs": "PlanningPool",
    "gcs.layout": "lay_out",
    "gcs.mission": (
        "Mission MissionOptions parse_mission_json parse_option read_mission station_faults with_options write_mission"
    ),
    "gcs.plan": "FailsafeReturn Place Plan ReturnRules failsafe_returns read_plan",
    "gcs.planning": "ReplanOrder default_planner plan_mission product_version recertify replan with_costs",
    "gcs.store": "DataOwner Entry FlightRecord Idempotency MissionRecord Store back_up restore",
    "link.autopilot": "PROFILES AutopilotProfile EkfOrigin",
    "link.dialect": "mavlink",
    "link.director": "PREFLIGHT_VALID_S judge_next",
    "link.files": "FORMATS FileJournal Format draw read_tlog report_and_traces report_flight setpoint_file",
    "link.microservices": "Parameter",
    "link.preflight": "Check Identity Level judge_failsafes judge_identity worst worst_first",
    "link.session": "FlightRequest",
    "link.setpoints": "RATE_LIMITS_HZ Setpoint SetpointSampler",
    "link.streamer": (
        "FlightResult RegisteredFlight RunningFlight VehicleClient ask attach epitaph events_of flight_on "
        "open_vehicle_client "
        "raise_priority registered_flights start_flight"
    ),
    "link.transport": "LinkLocks LinkUrl Sender is_local parse_url",
    "link.wire": "Signing SigningKey SigningStore StationCodec",
    "api.bench.paper": (
        "ALLOCATIONS TABLE_3 Results ResultsError Settings cells_3 draw_all matplotlib_available mean "
        "nlopt_available run summary table_3 table_4 tables_page"
    ),
    "api.bench.planner": (
        "DEFAULT_OPTIONS PAPER_OPTIONS SEGMENTS STATIONS Case drawn figures fixed mean_and_worst measure "
        "measure_costs reference_available routing_row segments_row warm_up"
    ),
    "api.cli": "main",
    "api.processes": "QUICK_MISSION Child ChildError Children home_under python_module start_simulator",
    "api.rest": "BACKLOG Limits connection_class create_app possible_connections",
    "api.rest.schemas": (
        "BAD_INPUT_EXAMPLE ENTRY_ID INFEASIBLE_EXAMPLE LOCAL_MISSION_EXAMPLE MISSION_EXAMPLE CommandBody "
        "FlightDetail FlightEvents FlightPage FlightSummary InfeasibleDetails LaunchCommand LinkEntry MissionBody "
        "MissionDetail MissionPage MissionProblem MissionSummary NewFlight PlanBody ProblemDetails RegisteredLink "
        "RegisteredStation RegisteredVehicle RegistryPage ReplanCommand ReplanProposal ReplanRequest Restored "
        "RestoreRequest StationEntry Status VehicleEntry VersionList"
    ),
    "api.service": (
        "Changes FlightService FlightStatus Metrics Proposal ReplanError ReplanFailedError ReplanInfeasibleError "
        "ReplanStateError Replanning ServiceError Services StillStoppingError configure_logging outer_state "
        "restore_vehicle"
    ),
    "sitl_fixtures.ardupilot": "ArduCopter",
    "sitl_fixtures.autopilot": "AutopilotModel",
    "sitl_fixtures.faults": "FAULTS FaultSet listing",
    "sitl_fixtures.mavlink": "FENCE MISSION RALLY Item",
    "sitl_fixtures.process": "Address Impairment LossyChannel run_process",
    "sitl_fixtures.px4": "Px4",
    "sitl_fixtures.vehicle": "SimulatedAutopilot SimulatorConfig",
}
"""What each face shows, by name: a name more or less is a decision, taken here. The others show nothing."""

WORDS = {
    "lens": "overlap",
    "taut": "funnel algorithm",
    "refuge": "Chebyshev centre",
    "shooting": "transcription",
    "custody": "control loss",
    "loan": "borrowed settings",
    "keeper": "GCS id manager",
    "desk": "client, service",
    "personality": "autopilot model",
    "manners": "autopilot model",
    "stranger": "foreign ground station",
}
"""Invented words for what the field has a word for: in no name of the product's code."""

LONG_FUNCTIONS: dict[str, str] = {
    "gcs/store/migrations/versions/m0001_first.py:upgrade": "the tables of the first version, one after another",
}
"""Functions of more than sixty lines, each with its reason: tables, and wiring told from beginning to end."""

FULL_FOLDERS: dict[str, str] = {
    "link/director": "a procedure each, from launch to landing, beside the core that runs them",
}
"""Folders of more than twelve modules, each with its reason."""


@cache
def whole() -> House:
    """Product and tests."""
    return House(ROOT, (*ALLOWED, "tests"), unread=GENERATED)


@cache
def product() -> House:
    """What ships."""
    return whole().only(*ALLOWED)


def report(offences: list[str]) -> str:
    """One a line, for the assertion."""
    return "\n".join(["", *offences])


@pytest.mark.slow
@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_import_direction(package: str) -> None:
    assert whole().of(package)
    offences = checks.against_direction(whole(), {package: ALLOWED[package]})
    assert not offences, report(offences)


@pytest.mark.slow
@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_rooms_import_only_lower_rooms(package: str) -> None:
    offences = checks.against_levels(product(), {package: LEVELS[package]}, APART)
    assert not offences, report(offences)


@pytest.mark.slow
def test_no_relative_imports() -> None:
    offences = checks.relative_imports(whole())
    assert not offences, report(offences)


@pytest.mark.slow
def test_no_circle_of_modules() -> None:
    offences = checks.module_circles(whole())
    assert not offences, report(offences)


@pytest.mark.slow
def test_only_the_bench_runs_experiments() -> None:
    offences = checks.only_from(product(), "planner.experiments", "api.bench")
    assert not offences, report(offences)


@pytest.mark.slow
def test_planner_and_simulator_have_no_ui_or_store() -> None:
    offences = checks.foreign_imports(product(), BANNED)
    assert not offences, report(offences)


@pytest.mark.slow
def test_packages_meet_at_their_faces() -> None:
    assert set(PUBLIC_MODULES) <= set(product().modules)
    offences = checks.past_a_face(product(), PUBLIC_MODULES)
    assert not offences, report(offences)


@pytest.mark.slow
@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_each_face_shows_what_is_expected_and_no_more(package: str) -> None:
    expected = {name: names.split() for name, names in SURFACE.items() if name.split(".")[0] == package}
    offences = checks.surface(product().only(package), expected)
    assert not offences, report(offences)


@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_public_names_exist(package: str) -> None:
    """What the faces list is there when they are imported."""
    faces = [module.name for module in product().of(package) if module.is_face]
    code = (
        "import importlib, sys\n"
        "for name in sys.argv[1:]:\n"
        "    face = importlib.import_module(name)\n"
        "    for shown in getattr(face, '__all__', ()):\n"
        "        getattr(face, shown)\n"
    )
    subprocess.run([sys.executable, "-c", code, *faces], check=True, cwd=ROOT)


@pytest.mark.slow
def test_no_module_is_hidden_by_a_name_its_face_shows() -> None:
    offences = checks.hidden_modules(product())
    assert not offences, report(offences)


@pytest.mark.slow
def test_no_test_imports_a_test() -> None:
    offences = checks.imports_of_tests(whole())
    assert not offences, report(offences)


@pytest.mark.slow
def test_modules_functions_and_folders_have_a_readers_size() -> None:
    helpers = House(ROOT, ("tests/support",))
    offences = [
        *checks.long_modules(product()),
        *checks.long_modules(helpers),
        *checks.long_functions(product(), LONG_FUNCTIONS),
        *checks.full_folders(product(), FULL_FOLDERS),
    ]
    assert not offences, report(offences)


def test_names_are_the_fields_own() -> None:
    offences = checks.invented_words(product(), WORDS)
    assert not offences, report(offences)


def tracked_files() -> list[Path]:
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listing.returncode:
        pytest.skip("not a git checkout")
    return [path for name in listing.stdout.split("\0") if name and (path := ROOT / name).is_file()]


def test_no_registry_address_and_no_machine_path() -> None:
    """Packages come by name, and nothing in the repository leads to one machine."""
    files = tracked_files()
    offences = [
        *texts.addresses(ROOT, files),
        *texts.machine_paths(ROOT, files, texts.own_paths(ROOT, Path.home())),
    ]
    assert not offences, report(offences)


@pytest.mark.slow
def test_packages_are_listed_explicitly() -> None:
    """Every folder with an ``__init__`` that should ship is in pyproject.toml."""
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    assert {module.name for module in product().modules.values() if module.is_face} == listed


def test_third_party_notices_cover_the_lock() -> None:
    from tests.support.third_party import PAGE, locked, page_parts

    page = PAGE.read_text(encoding="utf-8")
    parts = {name: version for name, (version, _) in page_parts().items()}
    missing = [name for name, version in (locked() | parts).items() if f"| {name} | {version} |" not in page]
    assert not missing, f"run `python -m tests.support.third_party`: {missing}"
