"""Target: the driving system under test, its environment, and the limits of the processes in which it runs."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from behavexplor.data.drawn_scenario import DEFAULT

TIME_LIMIT: Final = 300.0  # default limit of one execution [s]
MEMORY_LIMIT: Final = 8.0  # default limit of one worker process [GiB]


@dataclass(frozen=True)
class Target:
    """Everything that a process needs to know to execute scenarios.

    Attributes:
        env: name of the environment, see `behavexplor.envs.making.environment_id`.
        ads: name of the driving system, see `behavexplor.ads.loading.load_ads`.
        trust: digests ("sha256:...") of policy files that may run code while they are loaded.
        unconfined: whether a third-party ADS may write files and use the network.
        time_limit: limit of one execution [s]. It applies to worker processes only.
        memory_limit: limit of one worker process [GiB], where the system can set it.
        env_config: configuration of the environment, as far as it differs from what the driving system declares;
            None if it is not known.
        traffic: kind of traffic in a stock environment; see `behavexplor.data.drawn_scenario.Setup`.
        stochastic: whether the driving system draws its actions instead of deciding deterministically.
        confirm: whether highway-env itself confirms each failure in a stock environment that the compiled engine finds.
        modules: digests of the modules that a folder names and that were checked, by module; a process loads these
            bytes and no others, see `behavexplor.execution.checked_imports`. Modules that the user names need none.
    """

    env: str
    ads: str
    trust: tuple[str, ...] = ()
    unconfined: bool = False
    time_limit: float = TIME_LIMIT
    memory_limit: float = MEMORY_LIMIT
    env_config: Mapping[str, Any] | None = None
    traffic: str = DEFAULT
    confirm: bool = True
    stochastic: bool = False
    modules: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "trust", tuple(self.trust))  # JSON has lists only

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON values, from which `Target(**values)` makes an equal target."""
        return {**asdict(self), "trust": list(self.trust)}
