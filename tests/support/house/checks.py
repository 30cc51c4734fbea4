"""What must hold of the house: each check takes what is allowed and gives back the offences, naming file and line."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Mapping, Sequence

from tests.support.house.modules import House, circles, statements

Levels = Sequence[Sequence[str]]
"""Rooms of a package, lower levels first."""

# -- who may import whom ----------------------------------------------------------------------------------------------


def relative_imports(house: House) -> list[str]:
    """Imports that begin with a dot."""
    return [
        f"{module.path}:{one.line}: relative import of {one.module}"
        for module in house.modules.values()
        for one in module.imports
        if one.module.startswith(".")
    ]


def against_direction(house: House, allowed: Mapping[str, Iterable[str]]) -> list[str]:
    """Imports of a package of ours that the importing package may not know."""
    return [
        f"{module.path}:{one.line}: {module.package} imports {one.module}"
        for package, others in allowed.items()
        for module in house.of(package)
        for one in module.imports
        if one.module.split(".")[0] in house.packages and one.module.split(".")[0] not in {package, *others}
    ]


def foreign_imports(house: House, banned: Mapping[str, Iterable[str]]) -> list[str]:
    """Imports of libraries that a package has no business with."""
    return [
        f"{module.path}:{one.line}: {package} imports {one.module}"
        for package, names in banned.items()
        for module in house.of(package)
        for one in module.imports
        if one.module.split(".")[0] in names
    ]


def against_levels(house: House, levels: Mapping[str, Levels], apart: Iterable[tuple[str, str]] = ()) -> list[str]:
    """Imports from a lower room to a higher one, circles of rooms within a level, rooms without a level.

    `levels`: of each package its rooms, lower levels first. `apart`: pairs of rooms (``package.room``) that must not
    know each other though their levels would allow it. A package's own face stands above all its rooms.
    """
    offences = []
    for package, rows in levels.items():
        level = {room: k for k, row in enumerate(rows) for room in row}
        found = {module.room for module in house.of(package) if module.room is not None}
        offences += [f"{package}.{room}: a room without a level" for room in sorted(found - set(level))]
        offences += [f"{package}.{room}: a level for a room that is not there" for room in sorted(set(level) - found)]
        beside: dict[str, set[str]] = {}
        for module in house.of(package):
            for target, line in house.depends[module.name].items():
                other = house.modules[target]
                here, there = module.room, other.room
                if other.package != package or here == there or here is None or here not in level:
                    continue
                if there is None:
                    offences.append(f"{module.path}:{line}: {here} imports the face of {package} above it")
                elif there in level and level[there] > level[here]:
                    offences.append(f"{module.path}:{line}: {here} imports {target} of the higher {there}")
                elif (f"{package}.{here}", f"{package}.{there}") in _both_ways(apart):
                    offences.append(f"{module.path}:{line}: {here} imports {target}, and the two are to be apart")
                elif there in level and level[there] == level[here]:
                    beside.setdefault(here, set()).add(there)
        offences += [f"{package}: a circle of rooms: {', '.join(circle)}" for circle in circles(beside)]
    return offences


def _both_ways(pairs: Iterable[tuple[str, str]]) -> set[tuple[str, str]]:
    return {pair for one, other in pairs for pair in ((one, other), (other, one))}


def module_circles(house: House) -> list[str]:
    """Modules that import each other, directly or round about."""
    return [f"a circle of {len(circle)}: {', '.join(circle)}" for circle in circles(house.depends)]


def only_from(house: House, room: str, importers: str) -> list[str]:
    """Imports of a room (``package.room``) from anywhere but itself and below `importers`."""
    return [
        f"{module.path}:{line}: imports {target}, which is for {importers} alone"
        for module in house.modules.values()
        for target, line in house.depends[module.name].items()
        if _below(target, room) and not _below(module.name, room) and not _below(module.name, importers)
    ]


def _below(name: str, folder: str) -> bool:
    return name == folder or name.startswith(f"{folder}.")


# -- faces ------------------------------------------------------------------------------------------------------------


def past_a_face(house: House, public: Iterable[str]) -> list[str]:
    """Imports of another package that name neither its face, nor a room's, nor a module of `public`; and names that
    the face does not show."""
    offences = []
    for module in house.modules.values():
        for one in module.imports:
            package = one.module.split(".")[0]
            if package == module.package or package not in house.packages:
                continue
            where = f"{module.path}:{one.line}"
            target = house.modules.get(one.module)
            whole = f"{one.module}.{one.name}"
            if one.module in public or (whole in public and whole in house.modules):
                continue
            if target is None or not target.is_face or target.name.count(".") > 1 or one.name is None:
                offences.append(f"{where}: reaches past a face into {one.module}")
            elif one.name not in target.shown:
                offences.append(f"{where}: {one.module} does not show {one.name}")
    return offences


def surface(house: House, expected: Mapping[str, Iterable[str]]) -> list[str]:
    """Differences between what faces show and what they are expected to, and faces without a caption."""
    faces = {module.name: module for module in house.modules.values() if module.is_face}
    offences = [f"{name}: no such face" for name in sorted(set(expected) - set(faces))]
    for name, face in sorted(faces.items()):
        shown, wanted = set(face.shown), set(expected.get(name, ()))
        if not face.docstring:
            offences.append(f"{face.path}: opens without a caption")
        if len(shown) != len(face.shown):
            offences.append(f"{face.path}: lists a name twice")
        offences += [f"{face.path}: does not show {one}" for one in sorted(wanted - shown)]
        offences += [f"{face.path}: shows {one}, which nobody expects" for one in sorted(shown - wanted)]
        offences += [f"{face.path}: shows {one} and does not have it" for one in sorted(shown - _top_level(face.tree))]
    return offences


def _top_level(tree: ast.Module) -> set[str]:
    """Names a module's body binds."""
    found: set[str] = set()
    for node in statements(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            found |= {alias.asname or alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}
    return found


def hidden_modules(house: House) -> list[str]:
    """Modules with the name of something else their folder's face binds: the one hides the other."""
    return [
        f"{house.modules[f'{face.name}.{name}'].path}: hidden by the {name} that {face.path} shows"
        for face in house.modules.values()
        if face.is_face
        for name in sorted(_top_level(face.tree))
        if f"{face.name}.{name}" in house.modules and not house.is_module(face.name, name)
    ]


# -- sizes ------------------------------------------------------------------------------------------------------------


def long_modules(house: House, most: int = 400) -> list[str]:
    """Modules of more lines than that whose docstring has no line with the reason (``Long: ...``)."""
    return [
        f"{module.path}: {module.lines} lines, and its docstring has no line `Long:` with the reason"
        for module in house.modules.values()
        if module.lines > most and "Long:" not in module.docstring
    ]


def long_functions(house: House, reasons: Mapping[str, str], most: int = 60) -> list[str]:
    """Functions of more lines than that without a reason (by ``path:name``), and reasons nothing needs."""
    long = {
        f"{module.path}:{name}": lines
        for module in house.modules.values()
        for name, _, lines in module.functions()
        if lines > most
    }
    offences = [f"{where}: {lines} lines" for where, lines in sorted(long.items()) if not reasons.get(where)]
    return offences + [
        f"{where}: a reason for a function that is not long" for where in sorted(set(reasons) - set(long))
    ]


def invented_words(house: House, better: Mapping[str, str]) -> list[str]:
    """Names in the code that hold an invented word (a key, between underscores or capitals) for a word of the field."""
    offences: list[str] = []
    for module in house.modules.values():
        names = {n.name: n.lineno for n in ast.walk(module.tree) if isinstance(n, _NAMED)}
        names |= {n.arg: n.lineno for n in ast.walk(module.tree) if isinstance(n, ast.arg)}
        names |= {n.id: n.lineno for n in ast.walk(module.tree) if isinstance(n, ast.Name)}
        names[module.name.rpartition(".")[2]] = 1
        for name, line in sorted(names.items()):
            parts = {part.lower() for part in re.findall(r"[A-Z]?[a-z0-9]+|[A-Z]+", name)}
            offences += [f"{module.path}:{line}: {name}: say {better[word]}" for word in sorted(parts & better.keys())]
    return sorted(offences)


_NAMED = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


def full_folders(house: House, reasons: Mapping[str, str], most: int = 12) -> list[str]:
    """Folders of more modules than that without a reason; ``__init__`` and ``__main__`` do not count."""
    count: dict[str, int] = {}
    for module in house.modules.values():
        if not module.path.endswith(("__init__.py", "__main__.py")):
            folder = module.path.rpartition("/")[0]
            count[folder] = count.get(folder, 0) + 1
    offences = [f"{folder}: {n} modules" for folder, n in sorted(count.items()) if n > most and not reasons.get(folder)]
    full = {folder for folder, n in count.items() if n > most}
    return offences + [f"{folder}: a reason for a folder that is not full" for folder in sorted(set(reasons) - full)]


# -- tests ------------------------------------------------------------------------------------------------------------


def imports_of_tests(house: House, tests: str = "tests") -> list[str]:
    """Imports of a test module or a conftest, and of a helper by a name that does not begin with `tests`."""
    stems = {module.name.split(".")[-1] for module in house.of(tests)} - set(house.packages)
    offences = []
    for module in house.modules.values():
        for one in module.imports:
            parts = one.module.split(".")
            target = house.definer(one.module, one.name) or one.module
            if any(part == "conftest" or part.startswith("test_") for part in target.split(".")):
                offences.append(f"{module.path}:{one.line}: imports the tests of {target}")
            elif parts[0] in stems:
                offences.append(f"{module.path}:{one.line}: imports {parts[0]} without saying where it is")
    return offences
