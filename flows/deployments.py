"""A fleet on a Prefect server: work pool, deployments, schedules, and what happens by itself."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import Any

from prefect.client.orchestration import PrefectClient, get_client
from prefect.client.schemas.actions import WorkPoolCreate
from prefect.client.schemas.objects import ConcurrencyLimitConfig
from prefect.deployments.runner import RunnerDeployment
from prefect.events import Event
from prefect.events.actions import ActionTypes, DoNothing, RunDeployment, SendNotification
from prefect.events.schemas.automations import AutomationCore, EventTrigger, Posture
from prefect.events.schemas.events import Resource
from prefect.exceptions import ObjectAlreadyExists, ObjectNotFound
from prefect.schedules import Cron, Interval, Schedule
from prefect.types.entrypoint import EntrypointType
from prefect.workers.utilities import get_default_base_job_template_for_infrastructure_type

from flexmap_tasks.errors import ConfigError
from flexmap_tasks.fleet_config import FleetConfig, WorkPool
from flows.fleet_jobs import Job, find_jobs, load_fleet
from flows.fleet_pool import HEARTBEAT_S
from flows.fleet_update import fleet_update
from flows.map_trials import map_trials
from flows.map_update import map_update

RECORDINGS_ARRIVED = "flexmap.recordings.arrived"
NOTEWORTHY = ("Held", "Rejected", "Failed", "TimedOut", "Crashed")


async def deploy_fleet(file: Path) -> list[str]:
    """Register everything the fleet needs; again after every change of the file. Names of the deployments."""
    fleet = load_fleet(file)
    if fleet.work_pool is None:
        raise ConfigError(file.name, "a fleet that is deployed needs a work pool", "work_pool")
    async with get_client() as client:
        await _make_pool(client, fleet.work_pool)
        jobs = _one_per_map(fleet)
        names = [await _deploy_map(fleet, fleet.work_pool, job) for job in jobs]
        names += [await _deploy_trials(fleet, fleet.work_pool, job) for job in jobs]
        names.append(await _deploy_update(fleet, fleet.work_pool, file))
        for automation in await _automations(client, fleet, names[-1]):
            await _replace(client, automation)
    return names


async def announce_recordings(fleet: FleetConfig, maps: list[str]) -> None:
    """Tell the server that recordings arrived; the fleet's update starts by that event."""
    event = Event(
        event=RECORDINGS_ARRIVED,
        resource=Resource({"prefect.resource.id": f"flexmap.fleet.{fleet.name}"}),
        payload={"maps": maps},
    )
    async with get_client() as client:
        await client.request("POST", "/events", json=[event.model_dump(mode="json")])


def _one_per_map(fleet: FleetConfig) -> list[Job]:
    return list({job.entry.name: job for job in find_jobs(fleet)}.values())


async def _make_pool(client: PrefectClient, pool: WorkPool) -> None:
    try:
        await client.read_work_pool(pool.name)
    except ObjectNotFound:
        template = await get_default_base_job_template_for_infrastructure_type(pool.type)
        wanted = WorkPoolCreate(name=pool.name, type=pool.type, base_job_template=template or {})
        try:
            await client.create_work_pool(wanted)
        except ObjectAlreadyExists:  # someone else deploys at the same time
            return


async def _deploy_map(fleet: FleetConfig, pool: WorkPool, job: Job) -> str:
    """The deployment of one map: its settings are the form on the dashboard, filled in as the file has them."""
    deployment: RunnerDeployment = await map_update.ato_deployment(
        name=job.entry.name,
        parameters=_parameters(fleet, job),
        tags=_tags(fleet, job.entry.name),
        description=f"One recording becomes one release of the map {job.entry.name}.",
        work_pool_name=pool.name,
        job_variables=_job_variables(pool),
        entrypoint_type=EntrypointType.MODULE_PATH,
    )
    await deployment.aapply()
    return f"map_update/{job.entry.name}"


async def _deploy_trials(fleet: FleetConfig, pool: WorkPool, job: Job) -> str:
    """The same map with other settings beside each other; started by a person, who fills in what to try."""
    deployment: RunnerDeployment = await map_trials.ato_deployment(
        name=job.entry.name,
        parameters=_parameters(fleet, job),
        tags=_tags(fleet, job.entry.name),
        description=f"Compares releases of {job.entry.name} made with other settings; publishes none.",
        work_pool_name=pool.name,
        job_variables=_job_variables(pool),
        entrypoint_type=EntrypointType.MODULE_PATH,
    )
    await deployment.aapply()
    return f"map_trials/{job.entry.name}"


def _parameters(fleet: FleetConfig, job: Job) -> dict[str, Any]:
    releases = str(fleet.releases) if fleet.releases else None
    config = job.config.model_dump(mode="json", exclude_unset=True) if job.config is not None else None
    return {"store": fleet.store, "releases": releases, **({"config": config} if config else {})}


async def _deploy_update(fleet: FleetConfig, pool: WorkPool, file: Path) -> str:
    schedule = _schedule(fleet)
    deployment: RunnerDeployment = await fleet_update.ato_deployment(
        name=fleet.name,
        parameters={"fleet": str(file.resolve())},
        tags=_tags(fleet),
        description=f"Brings every map of {fleet.name} up to date.",
        work_pool_name=pool.name,
        job_variables=_job_variables(pool),
        entrypoint_type=EntrypointType.MODULE_PATH,
        concurrency_limit=ConcurrencyLimitConfig(limit=1),
        schedules=[schedule] if schedule is not None else [],
    )
    await deployment.aapply()
    return f"fleet_update/{fleet.name}"


def _schedule(fleet: FleetConfig) -> Schedule | None:
    wanted = fleet.schedule
    if wanted is None:
        return None
    if wanted.cron is not None:
        return Cron(wanted.cron, timezone=wanted.timezone)
    assert wanted.interval_s is not None  # noqa: S101 - Schedule gives one of the two
    return Interval(timedelta(seconds=wanted.interval_s), timezone=wanted.timezone)


def _tags(fleet: FleetConfig, *maps: str) -> list[str]:
    return [f"fleet:{fleet.name}", *(f"map:{name}" for name in maps)]


def _job_variables(pool: WorkPool) -> dict[str, Any]:
    """What the file says, and heartbeats often enough to tell within two minutes that a run is gone."""
    environment = {"PREFECT_FLOWS_HEARTBEAT_FREQUENCY": str(HEARTBEAT_S), **pool.job_variables.get("env", {})}
    return {**pool.job_variables, "env": environment}


async def _automations(client: PrefectClient, fleet: FleetConfig, update: str) -> list[AutomationCore]:
    deployment = await client.read_deployment_by_name(update)
    note = await _note(client, fleet)
    ours = {"prefect.resource.id": f"prefect.tag.fleet:{fleet.name}", "prefect.resource.role": "tag"}
    return [
        AutomationCore(
            name=f"{fleet.name}: recordings arrived",
            description="Updates the fleet when `flexmap fleet watch` or `notify` says that recordings arrived.",
            trigger=EventTrigger(
                expect={RECORDINGS_ARRIVED},
                match={"prefect.resource.id": f"flexmap.fleet.{fleet.name}"},
                posture=Posture.Reactive,
            ),
            actions=[RunDeployment(source="selected", deployment_id=deployment.id)],
        ),
        AutomationCore(
            name=f"{fleet.name}: held or failed",
            description="Says which run of a map was held, rejected or failed; recorded in the event feed.",
            trigger=EventTrigger(
                expect={f"prefect.flow-run.{state}" for state in NOTEWORTHY},
                match={"prefect.resource.id": "prefect.flow-run.*"},
                match_related=ours,
                posture=Posture.Reactive,
            ),
            actions=[note],
        ),
    ]


async def _note(client: PrefectClient, fleet: FleetConfig) -> ActionTypes:
    """What to do about a held or failed run: a note through the block, or only the entry in the event feed."""
    if fleet.notification_block is None:
        return DoNothing()
    kind, _, name = fleet.notification_block.partition("/")
    try:
        block = await client.read_block_document_by_name(name, kind)
    except ObjectNotFound:
        rule = f"no block {fleet.notification_block} on the server; create it there first"
        raise ConfigError(fleet.name, rule, "notification_block") from None
    return SendNotification(
        block_document_id=block.id,
        subject="FlexMap: {{ flow_run.name }} is {{ flow_run.state.name }}",
        body="{{ flow_run.state.message }}\n{{ flow_run|ui_url }}",
    )


async def _replace(client: PrefectClient, automation: AutomationCore) -> None:
    """Put an automation in place of those with its name."""
    for old in await client.read_automations_by_name(automation.name):
        await client.delete_automation(old.id)
    await client.create_automation(automation)
