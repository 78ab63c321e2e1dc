"""What code a stage runs: a digest over its import closure inside the package.

Blind to comments, docstrings and layout, so that only what can change a result changes the digest. Settings
(`config`) are left out because a stage's own settings are part of its key by value; the engine and the store
are left out because they only carry bytes.

The sources are read once, when this module is loaded with all the others: a file that is edited later does not
change what this process runs, and must not change what it says it ran.
"""

from __future__ import annotations

import ast
import functools
import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path

from flexmap_tasks import LOADED_NS
from flexmap_tasks.errors import InputError
from flexmap_tasks.store.artifact import canonical_json, digest_of, seal, unseal

PACKAGE = "flexmap_tasks"
LEFT_OUT = ("flexmap_tasks.config", "flexmap_tasks.engine", "flexmap_tasks.store", "flexmap_tasks.pipeline")
_ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True, slots=True)
class _Source:
    """A module as it was when the process began; `late` if it may have been loaded before its last edit."""

    path: Path
    content: bytes
    late: bool


def code_fingerprint(*roots: str) -> str:
    """Digest of the code that the given modules can reach."""
    return digest_of(canonical_json(code_modules(*roots)))


def code_modules(*roots: str) -> dict[str, str]:
    """Digest per module that the given modules can reach, themselves included.

    Raises InputError where a module was edited while this process was starting.
    """
    found: dict[str, str] = {}
    waiting = list(roots)
    while waiting:
        module = waiting.pop()
        source = _source(module)
        if module in found or module.startswith(LEFT_OUT) or source is None:
            continue
        if source.late:
            raise InputError(source.path.name, "was edited while FlexMap was starting; run again")
        found[module], imports = _parsed(module, source)
        waiting.extend(imports)
    return dict(sorted(found.items()))


def learn_code(memo: bytes | None) -> bytes | None:
    """Parse what neither this process nor the memo of another one knows; the memo for the next, None if the same."""
    body = unseal(memo) or {}
    for sha256, (digest, imports) in body.get(sys.version, {}).items():
        _PARSED.setdefault(sha256, (digest, tuple(imports)))
    known = {_name(module, source): _parsed(module, source) for module, source in sorted(_SOURCES.items())}
    content = seal(
        {sys.version: {name: [digest, list(imports)] for name, (digest, imports) in known.items()}}
    )
    return None if content == memo else content


_PARSED: dict[str, tuple[str, tuple[str, ...]]] = {}
"""(Digest of the syntax tree, imported modules) by digest over module name and source."""


def _parsed(module: str, source: _Source) -> tuple[str, tuple[str, ...]]:
    sha256 = _name(module, source)
    if sha256 not in _PARSED:
        tree = ast.parse(source.content)
        imports = tuple(sorted(_imports(tree, module, is_package=source.path.name == "__init__.py")))
        for node in ast.walk(tree):
            _strip_docstring(node)
        _PARSED[sha256] = digest_of(ast.dump(tree, annotate_fields=False).encode()), imports
    return _PARSED[sha256]


def _name(module: str, source: _Source) -> str:
    return digest_of(module.encode() + b"\0" + source.content)


def _source(module: str) -> _Source | None:
    if module.split(".", maxsplit=1)[0] == PACKAGE:
        return _SOURCES.get(module)
    return _outer_source(module)


@functools.cache
def _outer_source(module: str) -> _Source | None:
    """A stage that lives outside of the package counts with its own file."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return _read(Path(file)) if file else None


def _read(path: Path) -> _Source:
    stat = path.stat()
    content = path.read_bytes() + (_beside(path.parent) if path.name == "__init__.py" else b"")
    return _Source(path, content, max(stat.st_mtime_ns, stat.st_ctime_ns) > LOADED_NS)


def _beside(folder: Path) -> bytes:
    """Files of a package that are no Python, such as the page of the report: code as well, told by their digests."""
    others = [
        p for p in sorted(folder.iterdir()) if p.is_file() and p.suffix not in (".py", ".pyc", ".nbi", ".nbc")
    ]
    return (
        f"\n_BESIDE = { {p.name: digest_of(p.read_bytes()) for p in others}!r}\n".encode() if others else b""
    )


def _read_package() -> dict[str, _Source]:
    sources = {}
    for path in _ROOT.rglob("*.py"):
        parts = path.relative_to(_ROOT.parent).with_suffix("").parts
        sources[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = _read(path)
    return sources


_SOURCES = _read_package()


def _strip_docstring(node: ast.AST) -> None:
    if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
        return
    kept = [s for s in node.body if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))]
    node.body = kept or [ast.Pass()]


def _imports(tree: ast.AST, module: str, *, is_package: bool) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                package = module if is_package else module.rpartition(".")[0]
                base = importlib.util.resolve_name("." * node.level + base, package)
            names.add(base)
            names.update(f"{base}.{alias.name}" for alias in node.names)
    return {n for n in names if n.split(".")[0] == PACKAGE}
