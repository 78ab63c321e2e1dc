"""What code a stage runs: a digest over its import closure inside the package.

Blind to comments, docstrings and layout, so that only what can change a result changes the digest. Settings
(`config`) are left out because a stage's own settings are part of its key by value; the engine and the store
are left out because they only carry bytes.
"""

from __future__ import annotations

import ast
import functools
import importlib.util
from pathlib import Path

from flexmap_tasks.store.artifact import canonical_json, digest_of

PACKAGE = "flexmap_tasks"
LEFT_OUT = ("flexmap_tasks.config", "flexmap_tasks.engine", "flexmap_tasks.store", "flexmap_tasks.pipeline")


def code_fingerprint(*roots: str) -> str:
    """Digest of the code that the given modules can reach."""
    return digest_of(canonical_json(code_modules(*roots)))


def code_modules(*roots: str) -> dict[str, str]:
    """Digest per module that the given modules can reach, themselves included."""
    found: dict[str, str] = {}
    waiting = list(roots)
    while waiting:
        module = waiting.pop()
        if module in found or module.startswith(LEFT_OUT):
            continue
        path = _path(module)
        if path is None:
            continue
        stat = path.stat()
        digest, imports = _read(module, path, stat.st_mtime_ns, stat.st_size)
        found[module] = digest
        waiting.extend(imports)
    return dict(sorted(found.items()))


@functools.lru_cache(maxsize=1024)
def _path(module: str) -> Path | None:
    base = Path(__file__).resolve().parents[1]
    inner = Path(*module.split(".")[1:])
    for candidate in (base / inner.with_suffix(".py") if inner.parts else None, base / inner / "__init__.py"):
        if candidate is not None and candidate.is_file():
            return candidate
    return None


@functools.lru_cache(maxsize=1024)
def _read(module: str, path: Path, _mtime_ns: int, _size: int) -> tuple[str, tuple[str, ...]]:
    tree = ast.parse(path.read_bytes())
    imports = tuple(sorted(_imports(tree, module, is_package=path.name == "__init__.py")))
    for node in ast.walk(tree):
        _strip_docstring(node)
    return digest_of(ast.dump(tree, annotate_fields=False).encode()), imports


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
