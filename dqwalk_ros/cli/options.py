"""Options that several commands share, and the values made from them."""

from __future__ import annotations

import contextlib
import functools
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dqwalk_ros.plants.table import PLANTS, entry
from dqwalk_ros.support.errors import ConfigError
from dqwalk_ros.support.output import unwritable
from dqwalk_ros.support.wording import unexpanded

if TYPE_CHECKING:
    from dqwalk_ros.config import Config

Function = Callable[..., Any]
Option = Callable[[Function], Function]
"""A decorator that adds options to the function of a command."""


def command(epilog: str) -> Callable[[Function], click.Command]:
    """Return a decorator that makes a command from a function; the epilog is printed without reformatting."""
    kept = "\n\n".join("\b\n" + paragraph for paragraph in epilog.strip("\n").split("\n\n"))
    return click.command(epilog=kept, context_settings={"max_content_width": 120, "show_default": True})


def _with(options: Sequence[Option], function: Function) -> Function:
    """Return a function with options added, in the order in which help shows them."""
    return functools.reduce(lambda made, option: option(made), reversed(options), function)


class Real(click.FloatRange):
    """Type of an option whose value is a number in a range; click's own accepts what is not a number."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number."""
        found: float = super().convert(value, param, ctx)
        if not math.isfinite(found):
            self.fail(f"expected a number, not {value!r}", param, ctx)
        return found


class Numbers(click.ParamType):  # type: ignore[type-arg]
    """Type of an option whose value is `count` numbers separated by commas."""

    name = "numbers"

    def __init__(self, count: int) -> None:
        self.count = count

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Return the numbers."""
        try:
            found = tuple(map(float, value.split(",")))
        except ValueError:
            found = ()
        if len(found) != self.count or not all(map(math.isfinite, found)):
            self.fail(f"expected {self.count} numbers separated by commas, not {value!r}", param, ctx)
        return found


def _formats(_: click.Context, __: click.Parameter, text: str) -> tuple[str, ...]:
    formats = tuple(part.strip().lower() for part in text.split(",") if part.strip())
    if not formats or not set(formats) <= {"png", "pdf", "svg"}:
        raise click.BadParameter(f"expected png, pdf or svg, separated by commas, not {text!r}")
    return formats


def config_option(default: str) -> Option:
    """Return the option --config."""
    return click.option("--config", metavar="CONFIG", default=default, help="Name or path of a configuration.")


class _PlantName(click.Choice[str]):
    """A name of the table of plants, or MODULE:CLASS of a user's own simulator."""

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        return value if ":" in value else super().convert(value, param, ctx)


def plant_option(plants: Sequence[str], default: str) -> Option:
    """Return the option --plant, for plants of the table."""
    about = "; ".join(f"{name}: {PLANTS[name].meaning}" for name in plants)
    return click.option("--plant", type=_PlantName(plants), default=default, help=f"{about}; MODULE:CLASS: your own.")


class Place(click.Path):
    """Type of an option whose value is a path; an empty one, of an unset variable, is not the current folder.

    Parameters
    ----------
    written : bool
        The path will be created or replaced: a folder that cannot be written to is found before a walk of minutes.
    """

    def __init__(self, *, written: bool = False, **options: bool) -> None:
        super().__init__(path_type=Path, **options)
        self._written = written

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path."""
        if value == "":
            self.fail("it is empty", param, ctx)
        if isinstance(value, str) and (why := unexpanded(value)):
            self.fail(f"'{value}': {why}", param, ctx)
        if self._written and isinstance(value, str) and (why := unwritable(Path(value))):
            self.fail(why, param, ctx)
        return super().convert(value, param, ctx)


def folder_option(default: str | None, shown: str = "") -> Option:
    """Return the option --out; `shown` describes a default that depends on another argument."""
    return click.option(
        "--out",
        metavar="DIR",
        type=Place(written=True),
        default=default,
        show_default=shown or True,
        help="Folder of the results.",
    )


bag_argument = click.argument("bag", type=Place())
namespace_option = click.option(
    "--namespace", metavar="NAME", help="Namespace of the robot, if the bag contains several."
)
walk_option = click.option(
    "--walk",
    metavar="MODULE:CLASS",
    default="",
    show_default=False,
    help="Class of the recorded walk, if it is your own (gait.walk).",
)
port_option = click.option(
    "--port",
    metavar="N",
    type=int,
    help="Port of the page; 0: any.  [default: 8080 or the next]",
)
set_option = click.option(
    "--set",
    "changes",
    metavar="KEY=VALUE",
    multiple=True,
    help="Change one parameter (`dqwalk config` lists them); may be repeated.",
)
params_option = click.option(
    "--params",
    metavar="FILE",
    multiple=True,
    type=Place(),
    help="Parameter file, such as that of `dqwalk identify`, or a name in config/overlays; may be repeated.",
)
force_option = click.option("--force", is_flag=True, help="Replace earlier results.")
quiet_option = click.option("--quiet", is_flag=True, help="Print no progress and no tables.")
jobs_option = click.option("--jobs", metavar="N", type=click.IntRange(1), default=2, help="Parallel processes.")
format_option = click.option(
    "--format",
    "formats",
    metavar="LIST",
    callback=_formats,
    default="png",
    help="Formats of the figures: png, pdf, svg, separated by commas.",
)


def beside(bag: Path, name: str) -> Path:
    """Return the path of a file or folder beside a bag; relative to this folder if it is below it."""
    place, here = bag.resolve().parent / name, Path.cwd()
    return place.relative_to(here) if place.is_relative_to(here) else place


def walk_options(plants: Sequence[str]) -> Option:
    """Return a decorator that adds the options of a walk.

    The function gets its configuration as `config`, the name of its plant, by default the first of `plants`, as
    `plant`, and the texts of --cmd-vel as `course`.
    """
    options: list[Option] = [
        setup_options("paper", plants, plants[0]),
        click.option(
            "--cycles", metavar="N", type=int, help="Cycles of four phases of the paper's walk (gait.cycles)."
        ),
        click.option("--first", type=click.Choice(["left", "right"]), help="First support foot (gait.first_support)."),
        click.option(
            "--cmd-vel",
            "course",
            metavar="X,Y,TURN,S",
            multiple=True,
            help="Steer a standing or dynamic walk: ahead, left [m/s], turn [rad/s], duration [s]; may be repeated.",
        ),
    ]

    def decorate(function: Function) -> Function:
        @functools.wraps(function)
        def wrapped(*, setup: Setup, cycles: Any, first: Any, course: Any, **rest: Any) -> Any:
            also = {"gait.cycles": cycles, "gait.first_support": first}
            return function(config=setup.made(also, course), plant=setup.plant, course=course, **rest)

        return _with(options, wrapped)

    return decorate


def _gathered(kind: type[Output | Setup], name: str, options: Sequence[Option]) -> Option:
    """Return a decorator that adds options, whose values the function gets as one object, the argument `name`."""

    def decorate(function: Function) -> Function:
        @functools.wraps(function)
        def wrapped(**given: Any) -> Any:
            own = {field.name: given.pop(field.name) for field in fields(kind) if field.name in given}
            return function(**{name: kind(**own)}, **given)

        return _with(options, wrapped)

    return decorate


@dataclass(frozen=True, kw_only=True)
class Setup:
    """Names of a configuration and a plant, parameter files, and texts KEY=VALUE; see `config_of`."""

    config: str
    params: tuple[Path, ...]
    plant: str
    changes: tuple[str, ...]

    def made(self, also: Mapping[str, Any] | None = None, course: Sequence[str] = ()) -> Config:
        """Return the configuration, with `also` the values of other options that stand for a parameter."""
        return config_of(self.config, self.changes, plant=self.plant, params=self.params, course=course, also=also)


def setup_options(default: str, plants: Sequence[str], plant: str) -> Option:
    """Return a decorator that adds the options of `Setup`, which the function gets as `setup`."""
    return _gathered(Setup, "setup", [config_option(default), plant_option(plants, plant), params_option, set_option])


@dataclass(frozen=True, kw_only=True)
class Output:
    """The folder of the results, whether earlier ones are replaced, and whether progress and tables are not printed."""

    out: Path | None
    force: bool = False
    quiet: bool = False

    @property
    def folder(self) -> Path:
        """`out`, for commands whose --out has a default."""
        assert self.out is not None
        return self.out


@dataclass(frozen=True, kw_only=True)
class Report(Output):
    """Output of a report: also the file formats of the figures, and whether none are drawn."""

    formats: tuple[str, ...]
    no_figures: bool


def output_options(default: str | None, shown: str = "") -> Option:
    """Return a decorator that adds the options of `Report`, which the function gets as `output`."""
    options: list[Option] = [
        folder_option(default, shown),
        force_option,
        format_option,
        click.option("--no-figures", is_flag=True, help="Draw nothing."),
        quiet_option,
    ]
    return _gathered(Report, "output", options)


@dataclass(frozen=True, kw_only=True)
class Many(Output):
    """Output of a study of many walks, and its number of processes or the address of a Dask scheduler."""

    jobs: int
    scheduler: str | None

    @contextlib.contextmanager
    def options(self, unit: str, end: Callable[[Any], str] = lambda _: "") -> Iterator[dict[str, Any]]:
        """Provide the keyword arguments of a study, with a progress bar that counts in `unit` and says each `end`."""
        from dqwalk_ros.cli.progress import Progress

        with Progress(quiet=self.quiet) as bar:
            bar.stage(0.0, "starting the processes, which on a new machine compile for some minutes")

            def progress(done: int, total: int, last: Any) -> None:
                how = f"; the last one {word}" if (word := end(last)) else ""
                bar(done / total, f"{done} of {total} {unit}{how}")

            yield {"force": self.force, "jobs": self.jobs, "scheduler": self.scheduler, "progress": progress}


def many_options(default: str | None, shown: str = "") -> Option:
    """Return a decorator that adds the options of `Many`, which the function gets as `many`."""
    scheduler = click.option(
        "--scheduler", metavar="ADDRESS", help="Dask scheduler to use instead, such as tcp://host:8786."
    )
    return _gathered(Many, "many", [jobs_option, scheduler, folder_option(default, shown), force_option, quiet_option])


def config_of(
    config: str,
    changes: Sequence[str] = (),
    *,
    plant: str = "",
    params: Sequence[Path] = (),
    course: Sequence[str] = (),
    also: Mapping[str, Any] | None = None,
) -> Config:
    """Return the configuration that the options of a command describe.

    They are --config, --plant, --params, --set and --cmd-vel; each one replaces values of those before. With a course
    the walk takes steps until its end. `also` are the values of options that stand for a parameter, None for those that
    were not given. A warning names the values of --config that the file of the plant replaces.

    Raises
    ------
    ConfigError
        If any of them is invalid.
    """
    from dqwalk_ros.config import load, overlaid, replaced, with_files
    from dqwalk_ros.walks.table import walk_type

    values: dict[str, Any] = {"gait.steps": 0} if course else {}
    values |= parse_overrides(changes)
    values |= {name: value for name, value in (also or {}).items() if value is not None}
    own = load(config)
    used = entry(plant) if plant else None
    file = used.parameters if used else ""
    if used and used.type:
        values["plant.name"] = plant
    made = with_files(overlaid(own, file) if file else own, params).updated(values, source="command line")
    if file and (warning := replaced(own, file, made, "--params FILE or --set KEY=VALUE, which are applied last")):
        print(f"dqwalk: {warning}", file=sys.stderr)
    if course and walk_type(made).phases(made):
        raise ConfigError("--cmd-vel steers a standing or dynamic walk, such as --config poppy, with gait.steps=0")
    return made


def parse_overrides(pairs: Sequence[str]) -> dict[str, Any]:
    """Return ``{key: value}`` from texts ``key=value``; a value is parsed as YAML, an empty one is the empty text.

    Raises
    ------
    ConfigError
        If a text does not have this form.
    """
    from dqwalk_ros.support import strict_yaml

    values: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.strip():
            raise ConfigError(f"--set needs KEY=VALUE, such as gait.step_length=0.04, not {pair[:80]!r}")
        values[key.strip()] = strict_yaml.read(text, source=f"--set {key.strip()[:80]}") if text.strip() else ""
    return values
