"""What becomes `latest`, and what does not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pydantic import ValidationError

from flexmap_tasks.config import GateLimit, GateParams
from flexmap_tasks.engine import gate
from flexmap_tasks.engine.release import Release
from flexmap_tasks.errors import HeldError, InputError, RejectedError
from flexmap_tasks.store.store import Store
from flows.verdicts import not_published

MAP = "town"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store.open(tmp_path / "store")


def candidate(store: Store, name: str, **figures: float | None) -> Release:
    folder = store.releases / MAP / name
    folder.mkdir(parents=True)
    measures = [
        {"name": n, "value": v, "unit": "m", "limit": None, "passed": None} for n, v in figures.items()
    ]
    (folder / "quality.json").write_text(json.dumps({"measures": measures}))
    (folder / "manifest.json").write_text("{}")
    return Release(folder, name, fresh=True)


def limits(*given: dict[str, object], missed: str = "publish") -> GateParams:
    return GateParams.model_validate({"limits": given, "missed_quality": missed})


def latest(store: Store) -> str | None:
    return gate.published_release(store, MAP)


def test_without_limits_everything_is_published(store: Store) -> None:
    for name in ("a", "b"):
        assert gate.pass_gate(store, candidate(store, name, rmse=9e9), MAP, GateParams()).state == "published"
        assert latest(store) == name
    assert (store.releases / MAP / "latest").readlink() == Path("b")


@pytest.mark.parametrize(
    ("limit", "value", "state"),
    [
        ({"max": 0.5}, 0.5, "published"),
        ({"max": 0.5}, 0.51, "held"),
        ({"min": 0.5}, 0.5, "published"),
        ({"min": 0.5}, 0.49, "held"),
        ({"max": 0.5, "otherwise": "reject"}, 0.51, "rejected"),
        ({"max": 0.5}, None, "held"),
        ({"max_rise": 0.1}, 1.1, "published"),
        ({"max_rise": 0.1}, 1.2, "held"),
        ({"max_rise": 0.1}, 0.1, "published"),
        ({"max_fall": 0.1}, 0.8, "held"),
        ({"max_fall": 0.1}, 5.0, "published"),
    ],
)
def test_a_limit_decides(store: Store, limit: dict[str, object], value: float | None, state: str) -> None:
    gate.pass_gate(store, candidate(store, "before", rmse=1.0), MAP, GateParams())
    verdict = gate.pass_gate(
        store, candidate(store, "now", rmse=value), MAP, limits({"measure": "rmse", **limit})
    )
    assert verdict.state == state
    assert latest(store) == ("now" if state == "published" else "before")
    assert bool(verdict.reasons) == (state != "published")
    assert verdict.against == "before"


def test_the_worst_limit_counts_and_all_reasons_are_given(store: Store) -> None:
    rules = limits(
        {"measure": "rmse", "max": 1.0, "otherwise": "reject"},
        {"measure": "lanes", "max": 1.0},
        {"measure": "rmse", "max": 0.5},
    )
    verdict = gate.pass_gate(store, candidate(store, "a", rmse=2.0, lanes=2.0), MAP, rules)
    assert verdict.state == "rejected"
    assert len(verdict.reasons) == 3
    assert latest(store) is None


def test_without_a_published_release_there_is_nothing_to_change_against(store: Store) -> None:
    rules = limits({"measure": "rmse", "max_rise": 0.1})
    assert gate.pass_gate(store, candidate(store, "first", rmse=7.0), MAP, rules).state == "published"


def test_a_missed_limit_of_the_evaluation_can_hold(store: Store) -> None:
    release = candidate(store, "a", rmse=2.0)
    measure = {"name": "rmse", "value": 2.0, "unit": "m", "limit": 1.0, "passed": False}
    (release.folder / "quality.json").write_text(json.dumps({"measures": [measure]}))
    assert gate.pass_gate(store, release, MAP, limits(missed="hold")).state == "held"
    assert gate.pass_gate(store, release, MAP, limits(missed="reject")).state == "rejected"
    assert gate.pass_gate(store, release, MAP, limits()).state == "published"


def test_what_is_published_stays_so_when_limits_get_tighter(store: Store) -> None:
    release = candidate(store, "a", rmse=2.0)
    gate.pass_gate(store, release, MAP, GateParams())
    assert gate.pass_gate(store, release, MAP, limits({"measure": "rmse", "max": 1.0})).state == "published"


def test_a_person_publishes_what_was_held_and_that_stands(store: Store) -> None:
    rules = limits({"measure": "rmse", "max": 1.0})
    gate.pass_gate(store, candidate(store, "good", rmse=0.5), MAP, rules)
    held = candidate(store, "held", rmse=2.0)
    assert gate.pass_gate(store, held, MAP, rules).state == "held"
    gate.publish_by_hand(store, MAP, "held", latest(store))
    gate.make_latest(store, held)
    again = gate.pass_gate(store, held, MAP, rules)
    assert (again.state, again.by, latest(store)) == ("published", "person", "held")
    with pytest.raises(InputError, match="published already"):
        gate.publish_by_hand(store, MAP, "held", latest(store))


def test_a_rollback_goes_back_and_a_rerun_does_not_undo_it(store: Store) -> None:
    made = {n: candidate(store, n, rmse=1.0) for n in ("a", "b", "c")}
    for release in made.values():
        gate.pass_gate(store, release, MAP, GateParams())
    for published, expected in (("c", "b"), ("b", "a")):
        verdict = gate.withdraw(store, MAP, published, None)
        gate.make_latest(store, made[verdict.release])
        assert latest(store) == expected
        assert gate.pass_gate(store, made[published], MAP, GateParams()).state == "withdrawn"
        assert latest(store) == expected
    with pytest.raises(InputError, match="nothing to go back to"):
        gate.withdraw(store, MAP, "a", None)


def test_a_damaged_verdict_counts_as_none(store: Store) -> None:
    gate.pass_gate(store, candidate(store, "a", rmse=1.0), MAP, GateParams())
    path = store.backend.local(f"verdicts/{MAP}/a.json")
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content.replace(b"published", b"rejected_", 1))
    assert gate.read_verdict(store, MAP, "a") is None
    assert gate.read_verdicts(store, MAP) == {}


def test_verdicts_come_in_the_order_of_their_decision(store: Store) -> None:
    for name, when in (("x", "2026-01-02T00:00:00+00:00"), ("y", "2026-01-01T00:00:00+00:00")):
        gate.write_verdict(store, gate.Verdict(MAP, name, "held", ("why",), decided=when))
    assert list(gate.read_verdicts(store, MAP)) == ["y", "x"]


def test_a_limit_needs_a_bound() -> None:
    with pytest.raises(ValidationError, match="at least one"):
        GateLimit(measure="rmse")


def test_what_is_not_published_has_its_exit_code() -> None:
    held, rejected = (
        not_published(gate.Verdict(MAP, "a", s, ("rmse 2 m is over 1",))) for s in ("held", "rejected")
    )
    assert isinstance(held, HeldError)
    assert held.exit_code == 3
    assert "flexmap release publish town a" in str(held)
    assert isinstance(rejected, RejectedError)
    assert rejected.exit_code == 4
    assert not_published(gate.Verdict(MAP, "a", "published")) is None
