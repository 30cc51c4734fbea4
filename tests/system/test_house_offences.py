"""The checks of the house find what they are there for: each is shown a small house with one offence planted in it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.house import checks, texts
from tests.support.house.modules import House, circles

SOUND = {
    "under/__init__.py": '"""Below."""\nfrom under.shapes.disc import area_m2\n__all__ = ["area_m2"]\n',
    "under/errors.py": "class UnderError(Exception): ...\n",
    "under/shapes/__init__.py": '"""Shapes."""\nfrom under.shapes.disc import area_m2\n__all__ = ["area_m2"]\n',
    "under/shapes/disc.py": "def area_m2(r_m): return 3 * r_m**2\ndef girth_m(r_m): return 6 * r_m\n",
    "under/routes/__init__.py": '"""Routes."""\n',
    "under/routes/walk.py": "from under.shapes import area_m2\nfrom under.errors import UnderError\n",
    "under/routes/ride.py": "from under.routes import walk\n",
    "over/__init__.py": '"""Above."""\n',
    "over/desk.py": "from under import area_m2\nfrom under.shapes import area_m2 as same\nfrom under import errors\n",
    "tests/support/kit.py": "STATIONS = 3\n",
    "tests/test_disc.py": "from tests.support.kit import STATIONS\nfrom under.shapes.disc import girth_m\n",
    "tests/conftest.py": "import pytest\n",
}
"""Two packages, `over` above `under`; in `under` the room `routes` above `shapes`."""
LEVELS = {"under": (("errors",), ("shapes",), ("routes",)), "over": (("desk",),)}
ALLOWED = {"under": (), "over": ("under",)}
SURFACE = {"under": ("area_m2",), "under.shapes": ("area_m2",)}

Build = Callable[..., House]


@pytest.fixture
def build(tmp_path: Path) -> Build:
    """The sound house, with these files put in, or taken out where the text is None."""

    def built(changes: dict[str, str | None] | None = None) -> House:
        for name, text in (SOUND | (changes or {})).items():
            if text is not None:
                path = tmp_path / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text)
        return House(tmp_path, ("under", "over", "tests"))

    return built


def test_a_sound_house_has_no_offences(build: Build) -> None:
    whole = build()
    house = whole.only("under", "over")
    assert len(house.modules) == 9
    assert len(whole.modules) == 12
    assert checks.relative_imports(whole) == []
    assert checks.against_direction(whole, ALLOWED) == []
    assert checks.foreign_imports(house, {"under": ["socket"]}) == []
    assert checks.against_levels(house, LEVELS) == []
    assert checks.module_circles(whole) == []
    assert checks.only_from(house, "under.routes", "over.desk") == []
    assert checks.past_a_face(house, ["under.errors"]) == []
    assert checks.surface(house, SURFACE) == []
    assert checks.hidden_modules(house) == []
    assert checks.imports_of_tests(whole) == []
    assert checks.long_modules(house) == []
    assert checks.long_functions(house, {}) == []
    assert checks.full_folders(house, {}) == []


# -- who may import whom ----------------------------------------------------------------------------------------------


def test_a_relative_import_is_found(build: Build) -> None:
    house = build({"under/routes/walk.py": "def go():\n    from ..shapes import disc\n"})
    assert checks.relative_imports(house) == ["under/routes/walk.py:2: relative import of ..shapes"]


@pytest.mark.parametrize(
    "text",
    [
        "import over.desk\n",
        "def late():\n    from over import desk\n",
        "if TYPE_CHECKING:\n    from over.desk import x\n",
    ],
)
def test_a_package_that_imports_one_above_it_is_found(build: Build, text: str) -> None:
    (offence,) = checks.against_direction(build({"under/errors.py": text}), ALLOWED)
    assert offence.startswith("under/errors.py:")
    assert ": under imports over" in offence


def test_a_product_that_imports_its_tests_is_found(build: Build) -> None:
    house = build({"over/desk.py": "from tests.support.kit import STATIONS\n"})
    assert checks.against_direction(house, ALLOWED) == ["over/desk.py:1: over imports tests.support.kit"]


def test_a_library_out_of_place_is_found(build: Build) -> None:
    house = build({"under/errors.py": "import socket\n"})
    assert checks.foreign_imports(house, {"under": ["socket"]}) == ["under/errors.py:1: under imports socket"]


@pytest.mark.parametrize(
    "text",
    [
        "from under.routes.walk import area_m2\n",
        "from under.routes import walk\n",
        "import under.routes.walk\n",
        "def late(): from under.routes import walk\n",
        "if TYPE_CHECKING: from under.routes.walk import area_m2\n",
    ],
)
def test_a_room_that_imports_a_higher_one_is_found(build: Build, text: str) -> None:
    house = build({"under/shapes/disc.py": text, "under/routes/walk.py": ""})
    assert checks.against_levels(house, LEVELS) == [
        "under/shapes/disc.py:1: shapes imports under.routes.walk of the higher routes"
    ]


def test_a_higher_room_behind_a_lower_face_is_found(build: Build) -> None:
    """It is the module that defines a name which counts, not the face it is taken from."""
    face = '"""Shapes."""\nfrom under.routes.walk import area_m2\n__all__ = ["area_m2"]\n'
    house = build({"under/shapes/__init__.py": face, "under/errors.py": "from under.shapes import area_m2\n"})
    found = checks.against_levels(house, LEVELS)
    assert "under/errors.py:1: errors imports under.routes.walk of the higher routes" in found
    assert "under/shapes/__init__.py:2: shapes imports under.routes.walk of the higher routes" in found


def test_a_room_that_imports_the_face_of_its_package_is_found_where_that_stands_for_a_higher_one(build: Build) -> None:
    house = build({"under/errors.py": "from under import area_m2\n"})
    assert checks.against_levels(house, LEVELS) == [
        "under/errors.py:1: errors imports under.shapes.disc of the higher shapes"
    ]
    house = build({"under/errors.py": "import under\n"})
    assert checks.against_levels(house, LEVELS) == ["under/errors.py:1: errors imports the face of under above it"]


def test_a_room_without_a_level_and_a_level_without_a_room_are_found(build: Build) -> None:
    house = build({"under/new.py": ""})
    assert checks.against_levels(house, LEVELS | {"over": (("desk", "gone"),)}) == [
        "under.new: a room without a level",
        "over.gone: a level for a room that is not there",
    ]


def test_rooms_beside_each_other_may_import_each_other_one_way_only(build: Build) -> None:
    beside = {"under": (("errors",), ("shapes", "routes"))}
    assert checks.against_levels(build(), beside) == []
    house = build({"under/shapes/disc.py": "import under.routes.ride\n"})
    assert checks.against_levels(house, beside) == ["under: a circle of rooms: routes, shapes"]


@pytest.mark.parametrize("pair", [("under.routes", "under.shapes"), ("under.shapes", "under.routes")])
def test_rooms_kept_apart_are_found_together(build: Build, pair: tuple[str, str]) -> None:
    found = checks.against_levels(build(), {"under": (("errors",), ("shapes", "routes"))}, [pair])
    assert found == ["under/routes/walk.py:1: routes imports under.shapes.disc, and the two are to be apart"]


@pytest.mark.parametrize(
    "text",
    [
        "from under.routes.ride import x\n",
        "def late():\n    import under.routes.ride\n",
        "if TYPE_CHECKING:\n    from under.routes import ride\n",
    ],
)
def test_a_circle_of_modules_is_found(build: Build, text: str) -> None:
    house = build({"under/routes/walk.py": text})
    assert checks.module_circles(house) == ["a circle of 2: under.routes.ride, under.routes.walk"]


def test_a_circle_through_a_face_is_one_of_the_modules_behind_it(build: Build) -> None:
    face = '"""Routes."""\nfrom under.routes.ride import go\n__all__ = ["go"]\n'
    house = build(
        {
            "under/routes/__init__.py": face,
            "under/routes/ride.py": "from under.errors import UnderError\ndef go(): ...\n",
            "under/errors.py": "from under.routes import go\n",
        }
    )
    assert checks.module_circles(house) == ["a circle of 2: under.errors, under.routes.ride"]


def test_circles_of_a_graph_are_its_strongly_connected_components() -> None:
    r"""::

    a → b → c → a      d → e ⇄ f      g      h → h
            └────────► d
    """
    graph = {"a": "b", "b": "c", "c": "ad", "d": "e", "e": "f", "f": "e", "g": "", "h": "h"}
    assert circles(graph) == [["a", "b", "c"], ["e", "f"]]
    long = {str(k): [str(k + 1)] for k in range(5000)}
    assert circles(long) == []
    assert circles(long | {"5000": ["0"]}) == [sorted(str(k) for k in range(5001))]


def test_a_room_for_one_importer_is_found_with_another(build: Build) -> None:
    house = build({"over/desk.py": "def late():\n    from under.routes import ride\n"})
    assert checks.only_from(house, "under.routes", "over.desk") == []
    assert checks.only_from(house, "under.routes", "over.bench") == [
        "over/desk.py:2: imports under.routes.ride, which is for over.bench alone"
    ]


# -- faces ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "offence"),
    [
        ("from under.shapes.disc import area_m2\n", "reaches past a face into under.shapes.disc"),
        ("import under.shapes.disc\n", "reaches past a face into under.shapes.disc"),
        ("import under.shapes\n", "reaches past a face into under.shapes"),
        ("from under.shapes import girth_m\n", "under.shapes does not show girth_m"),
        ("from under.shapes import disc\n", "under.shapes does not show disc"),
        ("from under import shapes\n", "under does not show shapes"),
        ("from under.private import x\n", "reaches past a face into under.private"),
        ("from under import private\n", "under does not show private"),
        ("def late(): from under.routes.walk import area_m2\n", "reaches past a face into under.routes.walk"),
    ],
)
def test_an_import_past_a_face_is_found(build: Build, text: str, offence: str) -> None:
    house = build({"over/desk.py": text, "under/private.py": "x = 1\n"}).only("under", "over")
    assert checks.past_a_face(house, ["under.errors"]) == [f"over/desk.py:1: {offence}"]


@pytest.mark.parametrize(
    ("name", "text", "offences"),
    [
        ("under/shapes/__init__.py", '"""Shapes."""\n', ["does not show area_m2"]),
        (
            "under/routes/__init__.py",
            '"""Routes."""\nfrom under.routes.walk import go\n__all__ = ["go"]\n',
            ["shows go, which nobody expects"],
        ),
        (
            "under/shapes/__init__.py",
            '"""Shapes."""\n__all__ = ["area_m2"]\n',
            ["shows area_m2 and does not have it"],
        ),
        ("over/__init__.py", "", ["opens without a caption"]),
        ("under/__init__.py", '"""Below."""\narea_m2 = 1\n__all__ = ["area_m2", "area_m2"]\n', ["lists a name twice"]),
    ],
)
def test_a_face_with_a_name_more_or_less_is_found(build: Build, name: str, text: str, offences: list[str]) -> None:
    house = build({name: text}).only("under", "over")
    assert checks.surface(house, SURFACE) == [f"{name}: {offence}" for offence in offences]


def test_what_a_face_brings_in_under_a_condition_is_seen_too(build: Build) -> None:
    face = "try:\n    from under.shapes.disc import area_m2\nexcept ImportError:\n    raise\n"
    house = build({"under/shapes/__init__.py": f'"""Shapes."""\n{face}__all__ = ["area_m2"]\n'})
    assert checks.surface(house.only("under"), SURFACE) == []
    assert house.definer("under", "area_m2") == house.definer("under.shapes", "area_m2") == "under.shapes.disc"


def test_an_expected_face_that_is_not_there_is_found(build: Build) -> None:
    assert checks.surface(build().only("under"), SURFACE | {"under.maps": ("draw",)}) == ["under.maps: no such face"]


def test_a_module_hidden_by_a_name_of_its_face_is_found(build: Build) -> None:
    face = '"""Shapes."""\nfrom under.shapes.disc import disc\n__all__ = ["disc"]\n'
    house = build({"under/shapes/__init__.py": face})
    assert checks.hidden_modules(house) == [
        "under/shapes/disc.py: hidden by the disc that under/shapes/__init__.py shows"
    ]


# -- sizes ------------------------------------------------------------------------------------------------------------


def test_a_long_module_without_a_reason_is_found(build: Build) -> None:
    house = build({"under/errors.py": '"""Errors."""\n' + "x = 1\n" * 400})
    assert checks.long_modules(house) == [
        "under/errors.py: 401 lines, and its docstring has no line `Long:` with the reason"
    ]
    assert checks.long_modules(build({"under/errors.py": '"""Errors.\n\nLong: a table."""\n' + "x = 1\n" * 400})) == []


def test_a_long_function_without_a_reason_and_a_reason_without_one_are_found(build: Build) -> None:
    text = 'class Desk:\n    def open(self):\n        """Said in\n        two lines."""\n' + "        x = 1\n" * 60
    house = build({"over/desk.py": text})
    assert checks.long_functions(house, {}) == ["over/desk.py:Desk.open: 61 lines"]
    assert checks.long_functions(house, {"over/desk.py:Desk.open": "a table"}) == []
    assert checks.long_functions(house, {}, most=61) == []
    found = checks.long_functions(build(), {"over/desk.py:Desk.open": "a table"})
    assert found == ["over/desk.py:Desk.open: a reason for a function that is not long"]


def test_an_invented_word_is_found_wherever_it_names_something(build: Build) -> None:
    better = {"keeper": "manager"}
    assert checks.invented_words(build(), better) == []
    text = "class IdKeeper:\n    pass\n\n\ndef keep(the_keeper):\n    keeper_s = beekeepers = 1\n"
    assert checks.invented_words(build({"over/keeper.py": text}), better) == [
        "over/keeper.py:1: IdKeeper: say manager",
        "over/keeper.py:1: keeper: say manager",
        "over/keeper.py:5: the_keeper: say manager",
        "over/keeper.py:6: keeper_s: say manager",
    ]


def test_a_full_folder_is_found(build: Build) -> None:
    assert checks.full_folders(build(), {"under": "why"}) == ["under: a reason for a folder that is not full"]
    house = build({f"over/room_{k}.py": "" for k in range(12)})
    assert checks.full_folders(house, {}) == ["over: 13 modules"]
    assert checks.full_folders(house, {"over": "a file a command"}) == []


# -- tests ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "offence"),
    [
        ("from tests.test_disc import girth_m\n", "imports the tests of tests.test_disc"),
        ("from tests import test_disc\n", "imports the tests of tests.test_disc"),
        ("from test_disc import girth_m\n", "imports the tests of test_disc"),
        ("from tests.conftest import pytest\n", "imports the tests of tests.conftest"),
        ("import conftest\n", "imports the tests of conftest"),
        ("from kit import STATIONS\n", "imports kit without saying where it is"),
    ],
)
def test_a_test_that_imports_a_test_is_found(build: Build, text: str, offence: str) -> None:
    house = build({"tests/routes/test_walk.py": text})
    assert checks.imports_of_tests(house) == [f"tests/routes/test_walk.py:1: {offence}"]


# -- texts ------------------------------------------------------------------------------------------------------------

ADDRESS = "https://packages.example/simple"


@pytest.mark.parametrize(
    "name",
    [
        "requirements.lock",
        "requirements-dev.txt",
        "pyproject.toml",
        "web/package.json",
        "web/package-lock.json",
        "web/.npmrc",
        "Makefile",
        "Dockerfile",
        "deploy/Dockerfile.slim",
        ".ci/run",
        ".github/workflows/test.yml",
        "uv.lock",
    ],
)
@pytest.mark.parametrize(
    "line",
    [ADDRESS, "git+ssh://host.example/x", "--index-url packages.example", "pip -q --trusted-host h", "registry = h"],
)
def test_an_address_in_a_package_file_is_found(tmp_path: Path, name: str, line: str) -> None:
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"numpy==2.0\n  {line}\n")
    (offence,) = texts.addresses(tmp_path, [path])
    assert offence.startswith(f"{name}:2: ")


def test_an_address_elsewhere_and_a_package_file_without_one_pass(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text(f"See {ADDRESS}.\n")
    (tmp_path / "Makefile").write_text("setup:\n\tpip install -r requirements.lock  # a comment: no // address\n")
    assert texts.addresses(tmp_path, sorted(tmp_path.iterdir())) == []


def under(*parts: str) -> str:
    """An absolute path, put together here so that this file holds none."""
    return "/".join(("", *parts))


@pytest.mark.parametrize(
    "path",
    [
        under("home", "anna", "notes.md"),
        under("Users", "anna", "notes.md"),
        under("root", ".cache"),
        "\\".join(("C:", "Users", "anna")),
        under("build", "agent-7", "skyrelay", "gcs", "plan"),
        under("build", "agent-7", "other"),
        under("scratch", "anna", "notes"),
    ],
)
def test_a_path_of_one_machine_is_found(tmp_path: Path, path: str) -> None:
    own = texts.own_paths(Path("/build/agent-7/skyrelay"), Path("/scratch/anna"))
    file = tmp_path / "notes.md"
    file.write_text(f"fine\nsee `{path}`\n")
    (offence,) = texts.machine_paths(tmp_path, [file], own)
    assert offence.startswith("notes.md:2: ")


def test_paths_every_machine_has_pass_and_so_does_what_is_no_text(tmp_path: Path) -> None:
    own = texts.own_paths(Path("/tmp/skyrelay"), Path(under("root")))
    assert own == ["/tmp/skyrelay"]
    fine = tmp_path / "notes.md"
    fine.write_text("/tmp/x /usr/lib/x /v1/missions/ID api/home/page.js /homepage/x ~/notes $HOME/x\n")
    picture = tmp_path / "picture.png"
    picture.write_bytes(b"\x89PNG\0" + under("home", "anna", "x").encode())
    assert texts.machine_paths(tmp_path, [fine, picture], own) == []
