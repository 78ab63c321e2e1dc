"""OpenStreetMap from a server: the `map` call of the OSM API 0.6, or an Overpass query."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from typing import Literal
from urllib.parse import urlsplit, urlunsplit

import httpx

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_merge import merge_extracts
from flexmap_tasks.model.maps import GeoBox

MAX_BYTES = 512 << 20
"""An answer larger than this is no extract around one drive."""
MAX_REQUESTS = 64
"""How often a box the API finds too large may be asked for in parts, all parts together."""
MAX_MESSAGE = 300


class OsmServerError(InputError):
    """The server is busy, failing or not reachable: the same request may work later."""


class _TooLargeError(Exception):
    """The API wants a smaller box."""


def download_extract(
    endpoint: str, api: Literal["osm06", "overpass"], box: GeoBox, timeout_s: float
) -> bytes:
    """OpenStreetMap XML of the box, with all nodes of its ways; parts of a box that is too large are merged.

    Raises OsmServerError when trying again may help, InputError when it will not.
    """
    name = _shown(endpoint)
    timeout = httpx.Timeout(timeout_s, connect=min(timeout_s, 20.0))
    headers = {"User-Agent": f"flexmap/{_version()}", "Accept": "application/xml, text/xml"}
    with httpx.Client(timeout=timeout, headers=headers, follow_redirects=True) as client:
        if api == "overpass":
            request = client.build_request("POST", endpoint, data={"data": overpass_query(box, timeout_s)})
            return _ask(client, name, request)
        parts = list(_in_parts(client, name, _map_address(endpoint), box))
    return parts[0] if len(parts) == 1 else merge_extracts(name, parts)


def overpass_query(box: GeoBox, timeout_s: float) -> str:
    """All highways and uses of land in the box with their nodes, versions and times."""
    limits = f"[out:xml][timeout:{max(1, int(timeout_s))}][maxsize:{MAX_BYTES}]"
    where = f"{box.south_deg:.7f},{box.west_deg:.7f},{box.north_deg:.7f},{box.east_deg:.7f}"
    return f'{limits};(way["highway"]({where});way["landuse"]({where}););(._;>;);out meta;'


def _in_parts(client: httpx.Client, name: str, address: str, box: GeoBox) -> Iterator[bytes]:
    """Answers for the box, or for its quarters where the API finds it too large, west to east, south to north."""
    open_boxes = [box]
    for _ in range(MAX_REQUESTS):
        if not open_boxes:
            return
        part = open_boxes.pop()
        sides = (part.west_deg, part.south_deg, part.east_deg, part.north_deg)
        request = client.build_request("GET", address, params={"bbox": ",".join(f"{s:.7f}" for s in sides)})
        try:
            yield _ask(client, name, request)
        except _TooLargeError:
            open_boxes.extend(reversed(_quarters(part)))
    if open_boxes:
        rule = f"the box {box} is too large for this server; use an Overpass endpoint or an extract file"
        raise InputError(name, rule)


def _quarters(box: GeoBox) -> list[GeoBox]:
    lon, lat = (box.west_deg + box.east_deg) / 2, (box.south_deg + box.north_deg) / 2
    return [
        GeoBox(box.west_deg, box.south_deg, lon, lat),
        GeoBox(lon, box.south_deg, box.east_deg, lat),
        GeoBox(box.west_deg, lat, lon, box.north_deg),
        GeoBox(lon, lat, box.east_deg, box.north_deg),
    ]


def _ask(client: httpx.Client, name: str, request: httpx.Request) -> bytes:
    try:
        response = client.send(request, stream=True)
        try:
            content = _bounded(name, response)
        finally:
            response.close()
    except httpx.TimeoutException:
        raise OsmServerError(
            name, "the server did not answer in time; try again or raise timeout_s"
        ) from None
    except (httpx.HTTPError, httpx.InvalidURL) as error:
        reason = str(error)[:MAX_MESSAGE] or type(error).__name__
        raise OsmServerError(name, f"the server cannot be reached ({reason})") from None
    _judge(name, response.status_code, content)
    return content


def _bounded(name: str, response: httpx.Response) -> bytes:
    content = bytearray()
    for piece in response.iter_bytes(1 << 20):
        content += piece
        if len(content) > MAX_BYTES:
            raise InputError(name, f"the answer is over {MAX_BYTES >> 20} MB; ask for a smaller box")
    return bytes(content)


def _judge(name: str, status: int, content: bytes) -> None:
    """Raise unless the answer is OpenStreetMap XML that the server finished."""
    said = " ".join(content[: 4 * MAX_MESSAGE].decode("utf-8", "replace").split())[:MAX_MESSAGE]
    if status == httpx.codes.BAD_REQUEST and ("too many nodes" in said or "too large" in said):
        raise _TooLargeError
    if status == httpx.codes.TOO_MANY_REQUESTS or status >= httpx.codes.INTERNAL_SERVER_ERROR:
        raise OsmServerError(name, f"the server is busy or failing (HTTP {status}); try again later: {said}")
    if status != httpx.codes.OK:
        rule = f"the server refused the request (HTTP {status}); check endpoint and api: {said}"
        raise InputError(name, rule)
    if b"<osm" not in content[:2000]:
        raise InputError(name, f"expected OpenStreetMap XML, the server sent: {said or 'nothing'}")
    if not content.rstrip().endswith(b"</osm>"):
        raise OsmServerError(name, "the answer is cut off; try again")
    remark = content.rfind(b"<remark>")
    if remark >= 0 and b"error" in content[remark : remark + MAX_MESSAGE].lower():
        words = content[remark + 8 : remark + MAX_MESSAGE].split(b"<")[0].decode("utf-8", "replace").strip()
        raise OsmServerError(name, f"the server did not finish: {words}; try again or raise timeout_s")


def _map_address(endpoint: str) -> str:
    address = endpoint.rstrip("/")
    return address if urlsplit(address).path.endswith("/map") else f"{address}/map"


def _shown(endpoint: str) -> str:
    """The address without user, password and query."""
    parts = urlsplit(endpoint)
    return urlunsplit((parts.scheme, parts.netloc.rpartition("@")[2], parts.path, "", ""))


def _version() -> str:
    try:
        return version("flexmap")
    except PackageNotFoundError:
        return "unknown"
