"""Target: the driving system under test, its environment, and the conditions under which it drives.

The files, flags and Python interface of campaigns have the name, type, default and description of each setting from
here.
"""

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields
from types import MappingProxyType
from typing import Any, Final, Literal

from behavexplor.data.drawn_scenario import DEFAULT, Traffic
from behavexplor.errors import InputError

PAPERS_NAMES: Final = MappingProxyType(  # of environments
    {"S1": "intersection-straight", "S2": "intersection-left", "S3": "lane-follow", "S4": "lane-change"}
)
Activation = Literal["relu", "tanh", "elu", "gelu", "silu", "leaky_relu", "sigmoid", "identity"]
LEAST_MEMORY: Final = 0.5  # [GiB]
LEAST_TIME: Final = 0.1  # [s]
MOST: Final = 1e9  # of either limit
# settings on which an episode depends, beside the environment, the driver and the scenario
OF_EPISODES: Final = ("env_config", "traffic", "stochastic", "activation")


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """The conditions under which driving systems drive.

    Attributes:
        trust: Allow the folder or policy file with this digest ("sha256:...") to execute code.
        unconfined: Allow an ADS that is not shipped with behavexplor to write files and use the network. By default its
            worker processes may not, where the system can prevent it.
        time_limit: Time limit of one execution [s]. An ADS that takes longer counts as a hang. It applies to worker
            processes only.
        memory_limit: Memory limit of one worker process [GiB], where the system can set it.
        traffic: Traffic in highway-env's own environments: their own, or a wider range (docs/highway-policies.md).
        confirm: Repeat the first failures of each class in highway-env's own environments with highway-env itself.
        stochastic: Draw the actions of a stochastic policy as in its training, reproducibly, instead of deciding
            deterministically.

    Raises:
        InputError: if a value is out of range.
    """

    trust: tuple[str, ...] = ()
    unconfined: bool = False
    time_limit: float = 300.0
    memory_limit: float = 8.0
    traffic: Traffic = DEFAULT
    confirm: bool = True
    stochastic: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "trust", tuple(self.trust))  # JSON has lists only
        if not LEAST_TIME <= self.time_limit < MOST:
            raise InputError(f"time_limit {self.time_limit} must be at least {LEAST_TIME} s and less than {MOST:g} s")
        if not LEAST_MEMORY <= self.memory_limit < MOST:
            raise InputError(
                f"memory_limit {self.memory_limit} must be at least {LEAST_MEMORY} GiB, which workers need, and less "
                f"than {MOST:g}"
            )
        check_digests(self.trust)


@dataclass(frozen=True)
class Target(Conditions):
    """The driving system under test in its environment.

    Attributes:
        env: Environment: intersection-left, intersection-straight, lane-change, lane-follow; one of highway-env's own,
            such as highway-fast-v0 (docs/highway-policies.md); or module:id of one that another module registers.
        ads: Driving system under test (ADS): rule, idm, constant, careful, learned:NAME (docs/policies.md), a policy
            file, or package.module:attribute of an object or class with a predict method.
        activation: Function between the layers of a policy whose file holds weights alone: relu, tanh, elu, gelu, silu,
            leaky_relu, sigmoid or identity.
        env_config: Configuration of the environment as in the policy's training, as far as it differs from what the
            policy declares: keys of highway-env (docs/highway-env.md).
    """

    env: str = "intersection-straight"
    ads: str = "rule"
    env_config: Mapping[str, Any] | None = None  # None if it is not known
    activation: Activation | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "env", PAPERS_NAMES.get(self.env, self.env))
        object.__setattr__(self, "ads", os.path.expanduser(self.ads))  # noqa: PTH111 - a name, not always a path

    @property
    def target(self) -> "CheckedTarget":
        """The fields of `Target` alone, for the processes that execute scenarios."""
        return CheckedTarget(**{one.name: getattr(self, one.name) for one in fields(Target)})

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values, from which `CheckedTarget(**values)` makes an equal target."""
        return {**asdict(self), "trust": list(self.trust)}


@dataclass(frozen=True)
class CheckedTarget(Target):
    """Everything that a process needs to know to execute scenarios.

    Attributes:
        modules: Digests of the modules that a folder names and that were checked, by module; a process loads these
            bytes and no others, see `behavexplor.execution.checked_imports`. Modules that the user names need none.
    """

    modules: Mapping[str, str] = field(default_factory=dict)


def check_digests(trust: Iterable[str]) -> None:
    """Check the form of digests.

    Raises:
        InputError: if one has another form.
    """
    for digest in trust:
        if not re.fullmatch(r"sha256:[0-9a-f]{64}", digest):
            raise InputError(
                f"--trust {digest!r} must be sha256: and the 64 hexadecimal digits of a policy file or a folder"
            )
