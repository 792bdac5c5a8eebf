"""List the commands: the function of each, its group on the help page, and an example.

The help of a command is the docstring of its function. What a command prints is decided here.
"""

from __future__ import annotations

import importlib
import inspect
import operator
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import stiff_bench
import stiffbench as sb
from stiff_bench import api
from stiff_bench.api import RESULTS
from stiff_bench.console import (
    SCREEN,
    print_markdown,
    print_prose,
    print_text,
    say,
    warnings_on_stderr,
)
from stiff_bench.parameter_types import (
    Bounds,
    Device,
    FilePath,
    Folder,
    Form,
    Frames,
    HeldJoints,
    Picture,
    Seed,
    Setting,
)
from stiff_bench.tables.units import counted
from stiff_protocols.contract.errors import ConfigError
from stiffbench.options import (
    Execution,
    choose_format,
    command_line,
    find_own_data,
    select,
    use_plugins,
)


def show_text(result: object) -> int:
    """Print a result as sentences, and Markdown from its first heading on."""
    prose, _, markdown = f"\n{result}".partition("\n# ")
    if prose:
        print_prose(prose[1:])
    if markdown:
        print_markdown(f"# {markdown}")
    return 0


def show_tables(result: sb.Tables, fmt: Annotated[str, choose_format]) -> int:
    """Print tables in a format."""
    print_text(result.text_as(fmt), laid_out=fmt == SCREEN)
    return 0


def show_nothing(result: int) -> int:
    """Return the status of a command that prints its results itself."""
    return result


def show_rows(result: int) -> int:
    """Print the number of written rows."""
    return show_text(f"{counted(result, 'row')} written")


def show_check(result: Any) -> int:
    """Print the outcomes of checks; return 1 if one failed."""
    return show_text(result) or int(not result.passed)


def show_validation(result: Any) -> int:
    """Print a report; return the number of its verdict."""
    return show_text(result) or ("ok", "suspicious", "invalid").index(result.verdict)


def _fit(
    models: Sequence[str],
    output: FilePath,
    datasets: Sequence[str] = (),
    data: Annotated[Sequence[sb.Dataset], find_own_data] = (),
    settings: Setting = (),
    device: Device = "auto",
    seed: Seed = 0,
    cross_validate: bool = True,
    urdf_out: FilePath | None = None,
) -> str:
    """Fit a model to all samples of a data set and save it.

    As in `bench run`, a network chooses its number of epochs by cross-validation, then learns from
    every sample. With `training=best`, a fifth of the poses chooses the epoch instead.

    Args:
        models: model to fit; NAME@OPTION=VALUE sets its options.
        output: new file; an existing one is refused.
        datasets: data set to fit it to.
        settings: option of the model or the data set; may be repeated.
        device: device that networks run on.
        seed: seed of the model, and of the choice of validation poses.
        cross_validate: store the error at left-out poses, from one more fit for each fifth of the
            poses.
        urdf_out: also write the robot as a new URDF with the fitted TCP and joint stiffnesses.
    """
    from stiff_protocols.contract.files import check_new_file  # 10 ms

    model, samples = api.evaluation.model_and_data(
        models, [*datasets, *data], settings=settings, device=device
    )
    for file in (output,) if urdf_out is None else (output, urdf_out):
        check_new_file(Path(file))
    model.fit(samples, seed=seed)
    model.save(output, cross_validate=cross_validate)
    written = "" if urdf_out is None else f"\n{model.write_urdf(urdf_out)}"
    return f"{output}: {model.report(samples, seed)}{written}"


def _predict(model: sb.Model, output: FilePath, **options: Any) -> str:
    from tempfile import TemporaryDirectory  # 3 ms

    with TemporaryDirectory() as folder:
        file = Path(folder) / "rows.csv" if str(output) == "-" else Path(output)
        n_rows = model.predict_file(output=file, **options)
        if file != output:
            return file.read_text(encoding="utf-8").removesuffix("\n")
    robot = model.fitted.robot_.name
    return f"{output}: {counted(n_rows, 'row')} predicted by {model.name}, robot {robot}"


def _example(
    output: FilePath,
    robot: sb.Robot | None = None,
    model: sb.Model | None = None,
    hold: HeldJoints | None = None,
    **options: Any,
) -> object:
    held = hold if robot is None else None  # `name_robot` has held the joints of a URDF
    return sb.example_path(output, robot=robot, model=model, hold=held, **options)


def _compensate(
    model: sb.Model,
    output: FilePath,
    path: FilePath | None = None,
    program: FilePath | None = None,
    tool: Frames | None = None,
    workpiece: Frames | None = None,
    frame: Literal["world", "base", "tool"] | None = None,
    **options: Any,
) -> str:
    if (path is None) == (program is None):
        raise ConfigError("needed once: a file of points, or else --program", "path")
    kind = "path" if program is None else "program"
    compensate = sb.compensate_path if program is None else sb.compensate_program
    for name in options.keys() - inspect.signature(compensate).parameters.keys():
        raise ConfigError(f"does not go with --{kind}", name.replace("_", "-"))
    given = {"tool": tool, "workpiece": workpiece, "frame": frame}
    options |= {name: value for name, value in given.items() if value is not None}
    for name in ("tool", "workpiece") if path is not None else ():
        if name in options and [*options[name]] != [""]:
            raise ConfigError("needed once, as x,y,z,a,b,c, for a path", name)
        options |= {name: options[name][""]} if name in options else {}
    warnings.filterwarnings("ignore", r".* beyond the training range")  # printed below
    corrected = compensate(model, path or program or "", output, **options)
    files = ", ".join(map(str, getattr(corrected, "files", (output,))))
    return f"{corrected!r}\n{files}: {model.name}, robot {model.fitted.robot_.name}"


def _run(
    fmt: Annotated[str, choose_format],
    execution: Execution,
    models: Sequence[str] = (),
    datasets: Sequence[str] = (),
    data: Annotated[Sequence[sb.Dataset], find_own_data] = (),
    settings: Setting = (),
    study: str | None = None,
    lite: bool = False,
    against: Folder | None = None,
    output: Folder = RESULTS,
    plan_only: bool = False,
    verbose: bool = False,
    **options: Any,
) -> int:
    """Fit and test models; print which is best, and how sure that is.

    A fit is one model, trained and tested on one split. The VJM is always included as the baseline.
    Results are saved in --output at once; the same command continues an interrupted run.

    Args:
        settings: option of a model, data set or protocol; may be repeated.
        study: run a study of `bench reproduce`, or a file such as my_study.toml; --model replaces
            its models.
        lite: run the short version of the study: few robots, one split.
        against: also show results of other models; `published`: the results in the repository.
        output: folder that stores the results.
        plan_only: print how many fits are missing and, from stored fits, how long they take.
        verbose: also print a table of each data set, and what fits report, such as stiffnesses.
    """
    about: dict[str, Any] = {"output": Path(output), "command": command_line()}
    how = execution.arguments()
    if study is None:
        for word, value in (("lite", lite), ("against", against)):
            if value:
                raise ConfigError("requires --study", word)
        run = api.evaluation.prepare_run(
            [*datasets, *data] or [api.evaluation.DEFAULT_DATASET],
            models=models,
            protocols=options.pop("protocol", ("holdout",)),
            settings=settings,
            how=how,
            **about,
            **options,
        )
    else:
        given = {"dataset": datasets, "data": data, "set": settings, **options}
        for word in [name for name, value in given.items() if value not in ((), [])]:
            text = f"cannot be combined with --study; set it in {study}"
            raise ConfigError(text, "metric" if word == "metrics" else word)
        run = api.evaluation.run_of_study(
            study, models=models, lite=lite, against=str(against or ""), **about, **how
        )
    if plan_only:
        return show_tables(run.forecast(), fmt)
    answer = bool(models) if study else not options.get("metrics")
    return execute(run, fmt, answer=answer, verbose=verbose)


def execute(
    run: api.evaluation.Run, fmt: str, *, answer: bool = True, verbose: bool = False
) -> int:
    """Compute a run and print its tables; return 1 if a fit failed or was skipped, else 0.

    With `answer`, a terminal shows the best model in place of the metrics; elsewhere both are
    printed.
    """
    results = run.compute()
    facts = api.evaluation.run_facts(results)
    if (board := run.board(results)) is not None:
        show_tables(board, fmt)
    elif answer and fmt == SCREEN:
        show_tables(results.summary(verbose=verbose), fmt)
    else:
        if answer and fmt == "github" and (summary := results.summary()).text:
            show_tables(replace(summary, command=""), fmt)
            print_text("")
        show_tables(results.table(verbose=verbose), fmt)
    for line in facts:
        say(line)
    return 0 if all(result.status == "ok" for result in results.every) else 1


def _reproduce(
    name: str,
    fmt: Annotated[str, choose_format],
    execution: Execution,
    output: Folder = Path("results"),
    write_only: bool = False,
    site: Folder | None = None,
    plan_only: bool = False,
) -> int:
    """Run a study and write its page.

    Studies that stiffbench ships (times: on 2 cores):

        paper        tables and figures of the source paper; 1 h
        paper-quick  the same with one split and coarse sweeps; 7 min
        leaderboard  every model on 12 simulated robots and a measured one; 5 h
        intervals    do prediction intervals cover what they claim? 15 min
        fresh        the models on 12 robots that were drawn after them; 1.5 h

    Results are saved at once; the same command continues an interrupted study.

    Args:
        name: a shipped study, or a file such as my_study.toml.
        output: folder to write to; the study gets a folder in it.
        write_only: compute nothing; write from stored results.
        site: also write the web pages of the study's leaderboard to this folder.
        plan_only: print how many fits are missing and, from stored fits, how long they take.
    """
    command = command_line(without="--site")  # the page of results is the same with web pages
    run = api.evaluation.reproduction(
        name, output=Path(output), command=command, **execution.arguments()
    )
    if plan_only:
        return show_tables(run.forecast(), fmt)
    status = 0
    if not write_only:
        results = run.compute()
        for line in api.evaluation.run_facts(results):
            say(line)
        say("writing tables and figures")
        status = int(any(result.status == "failed" for result in results.every))
    for path in run.write():
        print_text(str(path))
    if site is not None:
        say(f"writing web pages to {site}")
        *_, first_page = run.write_site(Path(site))
        print_text(str(first_page))
    return status


def _report(
    output: Annotated[FilePath, Form("FILE.html")],
    selection: Annotated[sb.Selection, select],
    results: Annotated[Sequence[Path], Form("DIR")] = (RESULTS,),
    **ranking: Any,
) -> str:
    folders = [
        sb.Results(folder, command=command_line(), selection=selection) for folder in results
    ]
    return f"{sb.report(output, folders, **ranking)}: written"


def _figure(
    name: str,
    selection: Annotated[sb.Selection, select],
    results: Folder | None = None,
    output: Picture | None = None,
    data: Annotated[Sequence[sb.Dataset], find_own_data] = (),
    model_file: FilePath | None = None,
    row: Annotated[int, Bounds(at_least=0)] | None = None,
) -> str:
    """Draw a figure and print its caption.

    The caption names the data set and protocol that are drawn. The figure robot draws results
    (--results), a data set (--dataset or --data) or a model (--model-file).

    Args:
        name: figure of the source paper (4, 5, 6, 8, 9) or a general one: `bench list figures`.
        results: folder of results; by default results/runs, or results/paper/runs for the paper's
            figures.
        output: file to write: .png, .pdf or .svg; by default figure-NAME.png.
        model_file: file of a fitted model, for the figure robot: draw its prediction.
        row: sample of the figure robot, from 0; by default the one with the largest deflection.
    """
    from stiff_bench.tables.picture_file import check_suffix  # not needed for the first help page

    target = Path(output or f"figure-{name}.png")
    content: Any = results
    if data and (name != "robot" or results is not None):
        raise ConfigError("--data: drawn by the figure robot only, and without --results")
    if name == "robot" and results is None and (data or selection.datasets):
        if len([*data, *selection.options]) > 1:
            raise ConfigError("the figure robot draws one --dataset or --data, or --results")
        content = data[0] if data else sb.load_dataset(selection.datasets[0])
    elif selection.options:
        content = sb.Results(Path(results or RESULTS), selection=selection)
    check_suffix(target)
    model = None if model_file is None else sb.load_model(model_file)
    prepared = sb.figure(name, content, model=model, row=row)
    prepared.save(target)
    return f"{target}: {prepared.title}. {prepared.caption}"


def _table(
    number: Literal["1", "2", "3", "4", "5", "6", "7", "8", "9", "10"],
    results: Folder | None = None,
) -> sb.Tables:
    return sb.paper_table(number, results, command=command_line())


def _list(kind: Literal["models", "datasets", "protocols", "metrics", "figures"]) -> sb.Tables:
    """List models, data sets, protocols, metrics or figures.

    Args:
        kind: models, datasets, protocols, metrics or figures.
    """
    tables: sb.Tables = getattr(sb, f"list_{kind}")()
    return tables


def _verify(folder: Folder, **options: Any) -> sb.Tables:
    return api.submissions.verify_submission(folder, command=command_line(), **options)


@dataclass(frozen=True)
class Command:
    """A command of `bench`.

    Attributes:
        words: words that call it.
        public: public functions that it is made of, such as "Results.compare", or "module:name" in
            `stiff_bench`: the first docstring is its help, all have the texts of its options.
        options: options of an example; a line per example.
        call: function to call; None: the public function.
        show: function that prints its `result` and returns the exit status; its further parameters
            are options, too.
        without: parameters that are not options.
    """

    words: str
    public: str
    options: str
    call: Callable[..., Any] | None = None
    show: Callable[..., int] = show_text
    without: tuple[str, ...] = ()

    @property
    def example(self) -> str:
        """Return shell commands, one per line."""
        return "\n".join(f"bench {self.words} {line}" for line in self.options.splitlines())

    @property
    def places(self) -> list[tuple[str, str]]:
        """Return module and name of each public function."""
        places = [place.rpartition(":") for place in self.public.split()]
        return [
            (f"stiff_bench.{module}" if module else sb.MODULE_OF[name.partition(".")[0]], name)
            for module, _, name in places
        ]

    @property
    def summary(self) -> str:
        """Return the first line of the help, read from the source without an import."""
        if self.call is not None and self.call.__doc__:
            return self.call.__doc__.partition("\n")[0]
        module, name = self.places[0]
        file = Path(stiff_bench.__file__).parents[1] / f"{module.replace('.', '/')}.py"
        pattern = rf'^ *def {name.rpartition(".")[2]}\(.*?"""(.*?)(?:"""|$)'
        match = re.search(pattern, file.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
        assert match is not None
        return match[1]

    def function(self) -> Callable[..., int]:
        """Return the function of words for cyclopts; it returns the exit status."""
        from stiff_bench.run.machine import prepare
        from stiffbench.signatures import CommandFunction, command_signature, spell_options

        prepare()  # before numpy is imported
        public: list[Any] = [
            operator.attrgetter(name)(importlib.import_module(module))
            for module, name in self.places
        ]
        body = CommandFunction(self.call or public[0], *public, without=self.without)
        show = CommandFunction(self.show, without=("result",))
        plugins = CommandFunction(use_plugins)
        plugin_options = plugins.options if self.words in WITH_PLUGINS else {}
        options = {**body.all_options(), **show.all_options(), **plugin_options}
        signature = command_signature(options)

        def call(*arguments: Any, **words: Any) -> int:
            given = signature.bind_partial(*arguments, **words).arguments
            plugins(given if plugin_options else {})  # `bench submit` has a --plugin of its own
            with warnings_on_stderr():
                return int(show(given, body(given)))

        call.__signature__ = signature  # type: ignore[attr-defined]
        docs = (function.__doc__ for function in (self.call, *public) if function is not None)
        call.__doc__ = spell_options(next(filter(None, docs)), options)
        return call


GROUPS = {
    "": "Benchmark stiffness models of industrial robots.",
    "data": "Plan, check, simulate and inspect data sets.",
    "path": "Correct tool paths for the deflection under load.",
    "new": "Write the first files of a plugin.",
    "results": "Export stored results.",
}
"""Name of a group of commands -> its help; "": all."""
WITH_PLUGINS = {
    *("data info", "data plan", "data export", "run", "figure", "fit", "predict", "path example"),
    *("path compensate", "map", "posture", "list", "show", "check"),
}
"""Commands with an option --plugin."""
COMMANDS = {
    "Your robot's data": [
        Command("data info", "Dataset.describe", "fanuc-r2000ic"),
        Command("data plan", "plan_poses", "--robot ur5 --poses 60 --output plan.csv"),
        Command("data validate", "validate", "my.csv --robot ur5", show=show_validation),
        Command("data simulate", "simulate", "--twin ur5 --samples 1000 --output simulated.csv"),
        Command(
            "data register",
            "api.data_files:register",
            "my.csv --robot ur5 --licence CC-BY-4.0\nmy.csv --dataset kr10-measured",
        ),
        Command("data export", "Dataset.export", "kr10-twin@plan=wide --output shared"),
    ],
    "Fit and test models": [
        Command(
            "run",
            "evaluate",
            "--model vjm --model vjm-gp --dataset fanuc-r2000ic --splits 5",
            _run,
            show_nothing,
        ),
        Command("reproduce", "", "paper-quick", _reproduce, show_nothing),
    ],
    "Read results": [
        Command("leaderboard", "Results.leaderboard", "--results results/runs", show=show_tables),
        Command(
            "compare",
            "Results.compare",
            "vjm-gp vjm --dataset fanuc-r2000ic",
            show=show_tables,
            without=("models",),
        ),
        Command("report", "report", "--output report.html", _report),
        Command("figure", "", "regression --output regression.pdf", _figure),
        Command("table", "paper_table", "10", _table, show_tables, ("command",)),
        Command("merge", "merge", "laptop/runs server/runs --output results/runs"),
        Command(
            "results export",
            "export_results",
            "--format csv --output results.csv",
            show=show_rows,
        ),
    ],
    "Use a model on your robot": [
        Command(
            "fit", "", "--model bayes-springs --data my.csv --robot ur5 --output my.stiff", _fit
        ),
        Command(
            "predict",
            "Model.predict_file",
            "--model my.stiff --input poses.csv --output deflections.csv",
            _predict,
            without=("self",),
        ),
        Command(
            "path example",
            "example_path",
            "--shape circle --size 300mm --output circle.csv\n--model my.stiff --output square.csv",
            _example,
        ),
        Command(
            "path compensate",
            "compensate_path compensate_program",
            "--model my.stiff --path circle.csv --output new.csv",
            _compensate,
        ),
        Command(
            "map",
            "stiffness_map",
            "--model my.stiff --load 0,0,-100 --plane xz --output map.png",
        ),
        Command(
            "posture",
            "rank_postures",
            "--model my.stiff --point 900,0,800,0,90,0 --load 0,0,-50,0,0,0\n"
            "--model my.stiff --path holes.csv --output postures.csv",
        ),
        Command(
            "export",
            "Model.export",
            "--model mlp.stiff --output mlp.onnx\n--model my.stiff --output my.c --format c",
        ),
    ],
    "Look up and add names": [
        Command("list", "", "models", _list, show_tables),
        Command("show", "show", "vjm-gp"),
        Command("check", "check", "my-model --plugin my_model.py", show=show_check),
        Command("new model", "model_tools.plugins:new_model", "my-model"),
    ],
    "Take part in the leaderboard": [
        Command("submit", "api.submissions:submit", "--card card.toml --output submission"),
        Command(
            "verify",
            "api.submissions:verify_submission",
            "results/submissions/quadratic-springs --lite",
            _verify,
            show_tables,
            ("command",),
        ),
    ],
}
"""Heading of the help page -> its commands."""
