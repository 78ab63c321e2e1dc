"""Findings as JSON in the shape that Autoware's map validator writes."""

from __future__ import annotations

import json
from collections.abc import Mapping

from flexmap_tasks.formats.clean_text import clean
from flexmap_tasks.model.maps import Findings

PRIMITIVES = {
    "node": "point",
    "way": "linestring",
    "lanelet": "lanelet",
    "area": "area",
    "regulatory_element": "regulatory element",
}
"""Our words for the validator's; everything else is "primitive"."""


def issues_json(groups: Mapping[str, tuple[Findings, tuple[str, ...]]]) -> bytes:
    """Requirements by name, each with its findings and the codes that were looked for, found or not."""
    requirements = [_requirement(name, findings, codes) for name, (findings, codes) in groups.items()]
    text = json.dumps({"requirements": requirements}, ensure_ascii=False, indent=1)
    return (text + "\n").encode()


def _requirement(name: str, findings: Findings, codes: tuple[str, ...]) -> dict[str, object]:
    by_code: dict[str, list[dict[str, object]]] = {code: [] for code in codes}
    for i in range(len(findings)):
        code = clean(str(findings.code[i]))
        by_code.setdefault(code, []).append(
            {
                "severity": str(findings.severity[i]).capitalize(),
                "primitive": PRIMITIVES.get(str(findings.primitive[i]), "primitive"),
                "id": int(findings.id[i]),
                "issue_code": f"FlexMap.{code}",
                "message": clean(str(findings.message[i])),
            }
        )
    validators = [
        {"name": f"flexmap.{code}", "passed": not issues} | ({"issues": issues} if issues else {})
        for code, issues in sorted(by_code.items())
    ]
    return {"id": name, "passed": not len(findings), "validators": validators}
