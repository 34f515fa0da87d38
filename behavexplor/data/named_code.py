"""Names in data by which code would be imported. Data may come from anyone, so names are checked before an import.

Configurations name drivers, methods, specs and environments. The files beside models, recorded scenarios and scenes
name environments, too, and configurations of highway-env name classes of vehicles. Names of this package and of
highway-env bring no code of anyone else.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from behavexplor.errors import brief

TRAFFIC_CLASS: Final = "other_vehicles_type"  # key of highway-env's configurations: the path of a class
_OURS: Final = ("behavexplor/", "highway_env.")


@dataclass(frozen=True)
class Code:
    """Code that data names."""

    key: str  # key under which it is named, such as "ads"
    name: str  # the name, such as "my_driver:MyDriver"
    module: str  # name of the module that would be imported

    def __str__(self) -> str:
        """Return the key and the name for messages."""
        return f"{self.key} {self.name}"


def attribute_code(key: str, name: str) -> tuple[Code, ...]:
    """Return the code of "package.module:attribute"."""
    return (Code(key, name, name.partition(":")[0]),)


def env_code(env: str) -> tuple[Code, ...]:
    """Return the code that makes an environment: that of "module:id", or of "namespace/id", which a plugin registers.

    Args:
        env: name of the environment, see `behavexplor.envs.making.environment_id`.
    """
    if env.startswith(_OURS) or not (":" in env or "/" in env):
        return ()
    module, colon, _ = env.rpartition(":")
    return (Code("env", env, module if colon else env.partition("/")[0]),)


def traffic_code(config: Mapping[str, Any] | None) -> tuple[Code, ...]:
    """Return the code of the class of vehicles that a configuration of highway-env names."""
    path = (config or {}).get(TRAFFIC_CLASS, "")
    if not isinstance(path, str):
        return (Code("env_config", brief(path), ""),)
    return () if not path or path.startswith(_OURS) else (Code("env_config", path, path.rpartition(".")[0]),)
