"""The house read from its syntax trees: who imports whom, what each room shows, how long things are.

Nothing is imported: a `House` parses the Python files below a folder. Imports count wherever they stand, in functions
and under ``TYPE_CHECKING`` too. An import of a name from a folder's ``__init__`` counts as an import of the module that
defines it, because that is the one the importer depends on.

::

    planner.routing.bound        a module; `planner` its package, `routing` its room
    planner.problem              a module of the root: a room of its own
    planner.routing              a face: the room's ``__init__``, showing what its ``__all__`` lists
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path


@dataclass(frozen=True)
class Import:
    """One imported name: `module` as written, `name` out of it (None for a plain ``import module``)."""

    line: int
    module: str
    name: str | None


@dataclass(frozen=True)
class Module:
    """A parsed file of the house."""

    name: str
    path: str
    """From the root, with slashes."""
    is_face: bool
    tree: ast.Module
    lines: int

    @property
    def package(self) -> str:
        """The folder at the top level."""
        return self.name.split(".")[0]

    @property
    def room(self) -> str | None:
        """First part of the name below the package; None for the package's own face."""
        parts = self.name.split(".")
        return parts[1] if len(parts) > 1 else None

    @property
    def docstring(self) -> str:
        """Of the module, or empty."""
        return ast.get_docstring(self.tree) or ""

    @cached_property
    def imports(self) -> tuple[Import, ...]:
        """Everything imported anywhere in the file; a relative import keeps its dots."""
        found = []
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                found += [Import(node.lineno, alias.name, None) for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                module = "." * node.level + (node.module or "")
                found += [Import(node.lineno, module, alias.name) for alias in node.names]
        return tuple(found)

    @cached_property
    def shown(self) -> tuple[str, ...]:
        """The literal ``__all__``; empty where there is none."""
        for node in self.tree.body:
            targets = node.targets if isinstance(node, ast.Assign) else []
            if any(isinstance(target, ast.Name) and target.id == "__all__" for target in targets):
                return tuple(ast.literal_eval(node.value))  # type: ignore[attr-defined]
        return ()

    def functions(self) -> Iterator[tuple[str, int, int]]:
        """Name with its classes, first line, and number of lines without decorators and docstring."""
        yield from _functions(self.tree, "")


def statements(tree: ast.AST) -> Iterator[ast.stmt]:
    """Statements a module runs when it is imported, those in its ``if`` and ``try`` among them."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.stmt):
            yield node
        if isinstance(node, ast.If | ast.Try | ast.With | ast.excepthandler):
            yield from statements(node)


def _functions(node: ast.AST, where: str) -> Iterator[tuple[str, int, int]]:
    for child in ast.iter_child_nodes(node):
        inside = where
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            inside = f"{where}.{child.name}".lstrip(".")
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            first = child.body[0]
            has_text = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
            text = (first.end_lineno or 0) - first.lineno + 1 if has_text else 0
            yield inside, child.lineno, (child.end_lineno or 0) - child.lineno + 1 - text
        yield from _functions(child, inside)


class House:
    """The modules below `root` in `packages`; `unread` are left out (generated code)."""

    def __init__(self, root: Path, packages: Iterable[str], unread: Iterable[str] = ()) -> None:
        self.root = root
        self.packages = tuple(packages)
        self.modules: dict[str, Module] = {}
        for package in self.packages:
            for path in sorted((root / package).rglob("*.py")):
                name = path.relative_to(root).as_posix()
                if name not in unread:
                    module = _read(path, name)
                    self.modules[module.name] = module

    def only(self, *packages: str) -> House:
        """The same house seen with these packages alone."""
        part = House(self.root, ())
        part.packages = packages
        part.modules = {module.name: module for module in self.of(*packages)}
        return part

    def of(self, *packages: str) -> list[Module]:
        """The modules of some packages."""
        return [module for module in self.modules.values() if module.package in packages]

    def definer(self, module: str, name: str | None) -> str | None:
        """The module of ours that an import depends on, or None where it is not ours."""
        if name is not None and self.is_module(module, name):
            return f"{module}.{name}"
        seen = set()
        while name is not None and module in self.modules and self.modules[module].is_face and module not in seen:
            seen.add(module)
            source = self._brought_in(module, name)
            if source is None:
                break
            module, name = source.module, source.name
            if f"{module}.{name}" in self.modules:
                return f"{module}.{name}"
        return module if module in self.modules else None

    def is_module(self, face: str, name: str) -> bool:
        """Whether that name of a folder is the module in it, and not something the face binds to the name."""
        source = self._brought_in(face, name)
        return f"{face}.{name}" in self.modules and (source is None or (source.module, source.name) == (face, name))

    def _brought_in(self, face: str, name: str) -> Import | None:
        """What a face imports under that name."""
        if face not in self.modules or not self.modules[face].is_face:
            return None
        for node in statements(self.modules[face].tree):
            if isinstance(node, ast.ImportFrom):
                for alias in node.names:
                    if (alias.asname or alias.name) == name and node.module is not None:
                        return Import(node.lineno, node.module, alias.name)
        return None

    @cached_property
    def depends(self) -> dict[str, dict[str, int]]:
        """Of each module the modules of ours it imports, with the first line that does."""
        found: dict[str, dict[str, int]] = {}
        for module in self.modules.values():
            mine = found.setdefault(module.name, {})
            for one in module.imports:
                target = self.definer(one.module, one.name)
                if target is not None and target != module.name:
                    mine[target] = min(one.line, mine.get(target, one.line))
        return found


def _read(path: Path, name: str) -> Module:
    text = path.read_text(encoding="utf-8")
    dotted = name.removesuffix(".py").replace("/", ".")
    is_face = dotted.endswith(".__init__")
    return Module(dotted.removesuffix(".__init__"), name, is_face, ast.parse(text, name), text.count("\n"))


def circles(graph: Mapping[str, Iterable[str]]) -> list[list[str]]:
    """Strongly connected components of more than one node, each sorted (Tarjan 1972, with a stack of its own)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    open_nodes: list[str] = []
    found = []

    def enter(node: str) -> tuple[str, Iterator[str]]:
        index[node] = low[node] = len(index)
        open_nodes.append(node)
        return node, iter(graph.get(node, ()))

    for root in graph:
        work = [] if root in index else [enter(root)]
        while work:
            node, rest = work[-1]
            other = next(rest, None)
            if other is None:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    at = open_nodes.index(node)
                    found.append(sorted(open_nodes[at:]))
                    del open_nodes[at:]
            elif other not in index:
                work.append(enter(other))
            elif other in open_nodes:
                low[node] = min(low[node], index[other])
    return sorted(component for component in found if len(component) > 1)
