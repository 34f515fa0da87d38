"""A cluster by its name on the command line."""

import json
import re
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from behavexplor.ads.loading import check_name
from behavexplor.errors import InputError, missing_library, unknown_name
from behavexplor.execution.cluster.on_dask import DaskCluster
from behavexplor.execution.cluster.on_ray import RayCluster
from behavexplor.execution.cluster.supervisor import Cluster, ClusterExecutor

MAX_NODES: Final = 256
CONNECT_SECONDS: Final = 20.0  # in which a cluster must have answered [s]
KINDS: Mapping[str, Callable[[str, int], Cluster]] = MappingProxyType({"ray": RayCluster, "dask": DaskCluster})

_ADDRESS = re.compile(r"(?:(?P<scheme>[a-z]+)://)?(?P<host>\[[0-9a-fA-F:.]+\]|[\w.-]+):(?P<port>\d{1,5})")
_SCHEMES = {"ray": {None, "ray"}, "dask": {None, "tcp", "tls"}}


def parse_cluster(text: str) -> tuple[str, str]:
    """The kind of a cluster and its address, which is empty for one that is to be started on this machine.

    Args:
        text: "ray" or "dask", alone or followed by ":" and an address: "ray:10.0.0.5:6379", "ray://10.0.0.5:10001",
            "dask:tcp://10.0.0.5:8786"; "ray:auto" is the one that this machine belongs to.

    Raises:
        InputError: if it is nothing of this.
    """
    kind, separator, address = text.partition(":")
    if kind not in KINDS:
        raise unknown_name('cluster ("ray" or "dask", with ":" and an address or without)', kind, KINDS)
    if not separator or (kind, address) == ("ray", "auto"):
        return kind, address
    address = f"{kind}:{address}" if address.startswith("//") else address
    found = _ADDRESS.fullmatch(address)
    if found is None or found["scheme"] not in _SCHEMES[kind] or not 0 < int(found["port"]) < 65536:
        example = {"ray": "ray:10.0.0.5:6379 or ray://10.0.0.5:10001", "dask": "dask:tcp://10.0.0.5:8786"}[kind]
        raise InputError(f"--cluster {text} has no address that can be used: write it as {example}")
    return kind, address


def cluster_executor(text: str, workers: int, settings: Mapping[str, Any]) -> ClusterExecutor:
    """An executor on a cluster.

    Args:
        text: see `parse_cluster`.
        workers: how many nodes, each with one worker; 0 stands for as many as the cluster has cores.
        settings: arguments of `behavexplor.execution.executor.make_executor` beside the workers.

    Raises:
        InputError: if there is no such cluster, no ADS can have such a name, or a node cannot do what this machine
            does.
    """
    kind, address = parse_cluster(text)
    check_name(settings["ads"])
    if found := _ADDRESS.fullmatch(address):
        _reach(found["host"].strip("[]"), int(found["port"]))
    try:
        cluster = KINDS[kind](address, workers)
    except ModuleNotFoundError as error:
        raise missing_library(f"--cluster {kind}", error.name, kind) from None
    count = workers or max(min(cluster.cores, MAX_NODES), 1)
    return ClusterExecutor(cluster, count, settings["ads"], (json.dumps(dict(settings)), str(Path.cwd())))


def _reach(host: str, port: int) -> None:
    """Whether somebody listens there: Ray would try for minutes, and end this process."""
    try:
        socket.create_connection((host, port), CONNECT_SECONDS).close()
    except OSError as error:
        raise InputError(f"No cluster answers at {host}:{port} ({error}): is it running there?") from error
