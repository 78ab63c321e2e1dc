"""moto's S3 server as a process of its own, on loopback."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator

import pytest

BUCKET = "maps"


@contextlib.contextmanager
def serve_s3() -> Iterator[dict[str, str]]:
    """The server with an empty bucket; yields the environment that reaches it."""
    pytest.importorskip("moto", reason="moto[server] is not installed")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    url = f"http://127.0.0.1:{port}"
    try:
        _wait_for(url, process)
        request = urllib.request.Request(f"{url}/{BUCKET}", method="PUT")
        urllib.request.urlopen(request, timeout=30).close()
        yield {
            "AWS_ENDPOINT_URL": url,
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_REGION": "us-east-1",
            "NO_PROXY": "127.0.0.1",
            "no_proxy": "127.0.0.1",
        }
    finally:
        process.kill()
        process.wait()


class BreakingProxy:
    """Hands on what a server and its clients say, and breaks every connection off after some bytes, down or up."""

    def __init__(
        self, server: dict[str, str], down_bytes: int | None = None, up_bytes: int | None = None
    ) -> None:
        self._port = int(server["AWS_ENDPOINT_URL"].rpartition(":")[2])
        self._down, self._up = down_bytes, up_bytes
        self.broken: list[int] = []
        self._listener = socket.create_server(("127.0.0.1", 0))

    def __enter__(self) -> tuple[int, list[int]]:
        threading.Thread(target=self._accept, daemon=True).start()
        return self._listener.getsockname()[1], self.broken

    def __exit__(self, *_: object) -> None:
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            server = socket.create_connection(("127.0.0.1", self._port))
            for source, sink, limit in ((client, server, self._up), (server, client, self._down)):
                threading.Thread(target=self._pump, args=(source, sink, limit), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket, limit: int | None) -> None:
        passed = 0
        with contextlib.suppress(OSError):
            while content := source.recv(65_536):
                sink.sendall(content)
                passed += len(content)
                if limit is not None and passed > limit:
                    self.broken.append(passed)
                    break
        for side in (source, sink):
            with contextlib.suppress(OSError):
                side.shutdown(socket.SHUT_RDWR)


def _wait_for(url: str, process: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and process.poll() is None:
        with contextlib.suppress(OSError):
            urllib.request.urlopen(f"{url}/moto-api/", timeout=5).close()
            return
        time.sleep(0.1)
    raise AssertionError("moto's server did not start")


if __name__ == "__main__":
    with serve_s3() as environment:
        print(environment, os.getpid())
        time.sleep(3600)
