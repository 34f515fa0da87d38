"""Cluster names on the command line."""

import re
import socket
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from behavexplor.errors import InputError, missing_library, unknown_name
from behavexplor.execution.cluster.on_dask import DaskCluster
from behavexplor.execution.cluster.on_ray import RayCluster
from behavexplor.execution.cluster.supervisor import Cluster

MAX_NODES: Final = 256
CONNECT_SECONDS: Final = 20.0  # time limit for a cluster to answer [s]
KINDS: Mapping[str, Callable[[str, int], Cluster]] = MappingProxyType({"ray": RayCluster, "dask": DaskCluster})

_ADDRESS = re.compile(r"(?:(?P<scheme>[a-z]+)://)?(?P<host>\[[0-9a-fA-F:.]+\]|[\w.-]+):(?P<port>\d{1,5})")
_SCHEMES = {"ray": {None, "ray"}, "dask": {None, "tcp", "tls"}}


def parse_cluster(text: str) -> tuple[str, str]:
    """Split the name of a cluster into its kind and its address. An empty address means a new cluster on this machine.

    Args:
        text: "ray" or "dask", alone or followed by ":" and an address: "ray:10.0.0.5:6379", "ray://10.0.0.5:10001",
            "dask:tcp://10.0.0.5:8786". "ray:auto" is the cluster that this machine belongs to.

    Raises:
        InputError: if the name is none of these.
    """
    kind, separator, address = text.partition(":")
    if kind not in KINDS:
        raise unknown_name('cluster ("ray" or "dask", with or without ":" and an address)', kind, KINDS)
    if not separator or (kind, address) == ("ray", "auto"):
        return kind, address
    address = f"{kind}:{address}" if address.startswith("//") else address
    found = _ADDRESS.fullmatch(address)
    if found is None or found["scheme"] not in _SCHEMES[kind] or not 0 < int(found["port"]) < 65536:
        example = {"ray": "ray:10.0.0.5:6379 or ray://10.0.0.5:10001", "dask": "dask:tcp://10.0.0.5:8786"}[kind]
        raise InputError(f"--cluster {text} has an invalid address: write it as {example}")
    return kind, address


def open_cluster(text: str, nodes: int) -> tuple[Cluster, int]:
    """Join a cluster, or start one on this machine.

    Args:
        text: name of the cluster, see `parse_cluster`.
        nodes: number of nodes; 0 for one node for each core.

    Returns:
        The cluster, and the number of nodes.

    Raises:
        InputError: if there is no such cluster, or its library is not installed.
    """
    kind, address = parse_cluster(text)
    if found := _ADDRESS.fullmatch(address):
        _reach(found["host"].strip("[]"), int(found["port"]))
    try:
        cluster = KINDS[kind](address, nodes)
    except ModuleNotFoundError as error:
        raise missing_library(f"--cluster {kind}", error.name, kind) from None
    return cluster, nodes or max(min(cluster.cores, MAX_NODES), 1)


def _reach(host: str, port: int) -> None:
    """Check that a server listens at an address. Without this check, Ray tries for minutes and then ends the process.

    Raises:
        InputError: if no server answers.
    """
    try:
        socket.create_connection((host, port), CONNECT_SECONDS).close()
    except OSError as error:
        raise InputError(f"No cluster answers at {host}:{port} ({error}): start it, or correct the address") from error
