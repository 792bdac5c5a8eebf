"""List the commands: the function of each, its group on the help page, and an example.

The help of a command is the docstring of its function. What a command prints is decided here.
"""

from __future__ import annotations

import importlib
import operator
import re
import sys
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
    print_markdown,
    print_prose,
    print_text,
    printable,
    say,
    warnings_on_stderr,
    wrapped,
)
from stiff_bench.parameter_types import Device, FilePath, Folder, Form, Picture, Seed, Setting
from stiff_bench.tables.units import counted
from stiff_protocols.contract.errors import ConfigError
from stiff_protocols.contract.files import check_new_file
from stiffbench.options import (
    Execution,
    Limits,
    choose_format,
    choose_refits,
    command_line,
    find_own_data,
    open_cases,
    read_drawn_model,
    select,
    use_plugins,
)

ONLY_PATH = ("sheet", "hold", "on_failure")
ONLY_PROGRAM = ("loads", "strict")
"""Options that only go with `--path`, or with `--program`."""
REFUSED = 1
INDENTS = "  ", 16 * " "
"""Before the first and the other lines of a check on a terminal."""


def _print_tables(tables: sb.Tables, fmt: str) -> None:
    print_text(tables.text_as(fmt), laid_out=_is_screen(fmt))


def _is_screen(fmt: str) -> bool:
    """Return whether tables are laid out for a terminal."""
    from stiff_bench.tables.table import SCREEN  # not needed for the first help page

    return fmt == SCREEN


def _show_description(text: str) -> None:
    (print_markdown if text.startswith("#") else print_prose)(text)


def _show_check(results: Any) -> int:
    print_prose(repr(results))
    return 0 if results.passed else 1


def _show_merge(merged: Any) -> None:
    for line in merged.report:
        say(line)


def _map(output: FilePath | None = None, figure: Picture | None = None, **options: Any) -> None:
    new_map = sb.stiffness_map(output=output, figure=figure, **options)
    files = ", ".join(str(file) for file in (output, figure) if file)
    print_prose(new_map.report + f"\nwritten: {files}" * bool(files))


def _show_postures(ranked: object) -> None:
    print_text(repr(ranked))


def _data_info(dataset: sb.Dataset, output: Folder = Path("results/info")) -> None:
    card = dataset.card
    print_prose(dataset.describe(output))
    if card:
        print_markdown(f"\n{card}")


def _validate(robot: sb.Robot | None = None, **options: Any) -> int:
    report = sb.validate(robot=robot, **options)
    print_prose(repr(report))
    if robot is None:
        default = api.measuring.DEFAULT_ROBOT
        print_prose(f"Robot: {default}, the default; name yours: --robot or --urdf")
    return ("ok", "suspicious", "invalid").index(report.verdict)


def _data_export(dataset: sb.Dataset, output: Folder) -> None:
    print_prose(dataset.export(output))


def _fit(
    models: Sequence[str],
    output: FilePath,
    datasets: Sequence[str] = (),
    data: Annotated[Sequence[sb.Dataset], find_own_data] = (),
    settings: Setting = (),
    device: Device = "auto",
    seed: Seed = 0,
    cross_validate: bool = True,
) -> None:
    model, samples = api.evaluation.model_and_data(
        models, [*datasets, *data], settings=settings, device=device
    )
    check_new_file(Path(output))
    model.fit(samples, seed=seed)
    model.save(output, cross_validate=cross_validate)
    print_prose(f"{output}: {model.report(samples, seed)}")


def _predict(model: sb.Model, output: FilePath, **options: Any) -> None:
    from tempfile import TemporaryDirectory  # 3 ms

    with TemporaryDirectory() as folder:
        file = Path(folder) / "rows.csv" if str(output) == "-" else Path(output)
        n_rows = model.predict_file(output=file, **options)
        if file != output:
            print_text(file.read_text(encoding="utf-8").removesuffix("\n"))
            return
    number = "1 row" if n_rows == 1 else f"{n_rows} rows"
    print_prose(f"{output}: {number} predicted by {model.name}, robot {model.fitted.robot_.name}")


def _export(model: sb.Model, output: FilePath) -> None:
    print_prose(model.export(output))


def _compensate(
    model: sb.Model,
    output: FilePath,
    path: FilePath | None = None,
    program: FilePath | None = None,
    **options: Any,
) -> None:
    if (path is None) == (program is None):
        raise ConfigError("needed once: a file of points, or else --program", "path")
    for name in ONLY_PROGRAM if program is None else ONLY_PATH:
        if name in options:
            kind = "--path" if name in ONLY_PATH else "--program"
            raise ConfigError(f"only goes with {kind}", name.replace("_", "-"))
    warnings.filterwarnings("ignore", r".* beyond the training range")  # printed below
    if program is not None:
        corrected = sb.compensate_program(model, program, output, **options)
        text, files = repr(corrected), ", ".join(map(str, corrected.files))
    else:
        text = repr(sb.compensate_path(model, str(path), output, **options))
        files = str(output)
    print_prose(f"{text}\n{files}: {model.name}, robot {model.fitted.robot_.name}")


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
    paper: bool = False,
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
        paper: on a terminal, print the source paper's table: MAE, STDE and ME.
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
        return _print_plan(run, fmt)
    answer = not paper and (bool(models) if study else not options.get("metrics"))
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
        _print_tables(board, fmt)
    elif _is_screen(fmt) and answer:
        facts[0] = f"Fits: {facts[0].replace(';', ',')}"
        print_text(results.screen(*facts, verbose=verbose), laid_out=True)
        facts = []
    else:
        if answer and fmt == "github" and (view := results.view()) is not None:
            _print_tables(replace(view, command=""), fmt)
            print_text("")
        _print_tables(results.table(verbose=verbose), fmt)
    for line in facts:
        say(line)
    return 0 if all(result.status == "ok" for result in results.every) else 1


def _print_plan(run: api.evaluation.Run, fmt: str) -> int:
    forecast = run.forecast()
    _print_tables(replace(forecast, text=""), fmt)
    say(forecast.text)
    return 0


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
        intervals    do prediction intervals cover what they claim?

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
        return _print_plan(run, fmt)
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


def _leaderboard(results: sb.Results, fmt: Annotated[str, choose_format], **ranking: Any) -> None:
    _print_tables(results.leaderboard(**ranking), fmt)


def _compare(
    results: Annotated[sb.Results, open_cases], fmt: Annotated[str, choose_format], **question: Any
) -> None:
    _print_tables(results.compare(**question), fmt)


def _report(
    output: Annotated[FilePath, Form("FILE.html")],
    selection: Annotated[sb.Selection, select],
    results: Annotated[Sequence[Path], Form("DIR")] = (RESULTS,),
    **ranking: Any,
) -> None:
    folders = [
        sb.Results(folder, command=command_line(), selection=selection) for folder in results
    ]
    sb.report(output, folders, **ranking)
    say(f"{output}: written")


def _figure(
    name: str,
    selection: Annotated[sb.Selection, select],
    results: Folder | None = None,
    output: Picture | None = None,
    data: Annotated[Sequence[sb.Dataset], find_own_data] = (),
    model_file: Annotated[sb.Model | None, read_drawn_model] = None,
    **options: Any,
) -> None:
    """Draw a figure and print its caption.

    The caption names the data set and protocol that are drawn. The figure robot draws results
    (--results), a data set (--dataset or --data) or a model (--model-file).

    Args:
        name: figure of the source paper (4, 5, 6, 8, 9) or a general one: `bench list figures`.
        results: folder of results; by default results/runs, or results/paper/runs for the paper's
            figures.
        output: file to write: .png, .pdf or .svg; by default figure-NAME.png.
    """
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
    prepared = sb.figure(name, content, model=model_file, **options)
    prepared.save(target)
    print_prose(f"{target}: {prepared.title}. {prepared.caption}")


def _table(
    number: Literal["1", "2", "3", "4", "5", "6", "7", "8", "9", "10"],
    fmt: Annotated[str, choose_format],
    results: Folder | None = None,
) -> None:
    _print_tables(sb.paper_table(number, results, command=command_line()), fmt)


def _results_add(
    folders: Annotated[Sequence[Path], Form("DIR...")],
    results: Folder = Path("results/leaderboard/runs"),
) -> None:
    """Add the fits of verified submissions to results.

    The fits are not computed again. `bench reproduce leaderboard --write-only` then has a column of
    status: verified or reported.

    Args:
        folders: folders of submissions that `bench verify` has verified or reported.
        results: folder of results to add to, with the VJM on the same splits.
    """
    for folder in folders:
        n_fits = api.submissions.add_submission(folder, Path(results))
        say(f"{results}: {n_fits} fits of {folder} added")


def _results_export(results: sb.Results, output: FilePath, **options: Any) -> None:
    n_records = sb.export_results(results, output, **options)
    say(f"{output}: {n_records} records written")


def _list(
    kind: Literal["models", "datasets", "protocols", "metrics", "figures"],
    fmt: Annotated[str, choose_format],
) -> None:
    """List models, data sets, protocols, metrics or figures.

    Args:
        kind: models, datasets, protocols, metrics or figures.
    """
    _print_tables(getattr(sb, f"list_{kind}")(), fmt)


def _submit(
    output: Folder,
    limits: Limits,
    results: Folder = RESULTS,
    lite: Annotated[bool, Form("--full")] | None = None,
    **options: Any,
) -> None:
    if lite is None:
        raise ConfigError("give --lite or --full")
    submission = api.submissions.submit(
        output=Path(output),
        results=Path(results),
        lite=lite,
        command=command_line(),
        **Execution(**vars(limits)).arguments(),
        **options,
    )
    n_records = counted(len(submission.records), "record")
    say(f"{output}: {submission.manifest.model}, {n_records} written; next: bench verify {output}")


def _verify(
    folders: Annotated[Sequence[Path], Form("DIR...")],
    refits: Annotated[api.submissions.Refits, choose_refits],
    study: str = "leaderboard",
    write: bool = False,
) -> int:
    """Verify submissions to the leaderboard.

    Hashes, schema, data and splits are checked, metrics are recomputed from the predictions, and a
    random tenth of the fits is computed again from the code, in isolated processes.

    Exit status: 0 nothing is wrong; 1 a submission is refused; 2 it cannot be read.

    Args:
        folders: folders of submissions.
        study: study, or a file such as my_study.toml.
        write: store the outcome in the folder, for the leaderboard's column of status.
    """
    outcomes = set()
    for folder in folders:
        verification = api.submissions.VerificationRun(folder, study, refits)
        for number, check in enumerate(verification):
            if not number:
                print_text(str(folder))
            on_terminal = sys.stdout.isatty()
            print_text(wrapped(printable(str(check)), *INDENTS) if on_terminal else f"  {check}")
        print_text(f"{verification.outcome}: {folder}")
        outcomes.add(verification.outcome)
        if write and verification.outcome != "refused":
            verification.write()
    return REFUSED if "refused" in outcomes else 0


@dataclass(frozen=True)
class Command:
    """A command of `bench`.

    Attributes:
        words: words that call it.
        public: names of the public functions that it is made of, in `stiff_bench.api`: the first
            docstring is its help, all of them have the texts of its options.
        example: shell commands, one per line.
        call: function to call; None: the public function.
        show: function that prints the result of the public function and may return a status.
        without: parameters of the public functions that `call` gives.
    """

    words: str
    public: str
    example: str
    call: Callable[..., int | None] | None = None
    show: Callable[[Any], int | None] = print_prose
    without: tuple[str, ...] = ()

    @property
    def summary(self) -> str:
        """Return the first line of the help, read from the source without an import."""
        if self.call is not None and self.call.__doc__:
            return self.call.__doc__.partition("\n")[0]
        module, _, place = self.public.split()[0].partition(":")
        file = Path(stiff_bench.__file__).parent / f"{module.replace('.', '/')}.py"
        source, name = file.read_text(encoding="utf-8"), place.rpartition(".")[2]
        match = re.search(rf'^ *def {name}\(.*?"""(.*?)(?:"""|$)', source, re.DOTALL | re.MULTILINE)
        assert match is not None
        return match[1]

    def function(self) -> Callable[..., int]:
        """Return the function of words for cyclopts; it returns the exit status."""
        from stiff_bench.run.machine import prepare
        from stiffbench.signatures import CommandFunction, command_signature, spell_options

        prepare()  # before numpy is imported
        public: list[Any] = [*map(_public_function, self.public.split())]
        body = CommandFunction(self.call or public[0], *public, without=self.without)
        plugins = CommandFunction(use_plugins)
        has_plugins = self.words in WITH_PLUGINS
        options = body.all_options() | (plugins.options if has_plugins else {})
        signature = command_signature(options)

        def call(*arguments: Any, **words: Any) -> int:
            given = signature.bind_partial(*arguments, **words).arguments
            plugins(given)
            with warnings_on_stderr():
                result = body(given)
                status = self.show(result) if self.call is None else result
            return status or 0

        call.__signature__ = signature  # type: ignore[attr-defined]
        call.__annotations__ = {
            name: parameter.annotation for name, parameter in signature.parameters.items()
        }
        docs = (function.__doc__ for function in (self.call, *public) if function is not None)
        call.__doc__ = spell_options(next(filter(None, docs)), options)
        return call


def _public_function(place: str) -> Callable[..., Any]:
    """Return the function of a place such as "results.results:Results.compare"."""
    module, _, name = place.partition(":")
    function: Callable[..., Any] = operator.attrgetter(name)(
        importlib.import_module(f"stiff_bench.{module}")
    )
    return function


GROUPS = {
    "": (
        "Benchmark stiffness models of industrial robots.",
        "bench run --model vjm --model vjm-gp --dataset fanuc-r2000ic --splits 5\n"
        "bench leaderboard\n"
        "bench run --help",
    ),
    "data": (
        "Plan, check, simulate and inspect data sets.",
        "bench data plan --robot ur5 --output plan.csv\nbench data validate my.csv --robot ur5",
    ),
    "path": (
        "Correct tool paths for the deflection under load.",
        "bench path example --model my.stiff --output square.csv\n"
        "bench path compensate --model my.stiff --path square.csv --output new.csv",
    ),
    "new": ("Write the first files of a plugin.", "bench new model my-model"),
    "results": (
        "Export stored results, and add results of submissions.",
        "bench results export --format csv --output results.csv",
    ),
}
"""Name of a group of commands -> its help and its example; "": all."""
WITH_PLUGINS = {
    *("data info", "data plan", "data export", "run", "figure", "fit", "predict", "path example"),
    *("path compensate", "map", "posture", "list", "show", "check"),
}
"""Commands with an option --plugin."""
COMMANDS = {
    "Your robot's data": [
        Command(
            "data info",
            "api.data_sets:Dataset.describe",
            "bench data info fanuc-r2000ic",
            _data_info,
        ),
        Command(
            "data plan",
            "api.measuring:plan_poses",
            "bench data plan --robot ur5 --poses 60 --output plan.csv",
        ),
        Command(
            "data validate",
            "api.measuring:validate",
            "bench data validate my.csv --robot ur5",
            _validate,
        ),
        Command(
            "data simulate",
            "api.measuring:simulate",
            "bench data simulate --twin ur5 --samples 1000 --output simulated.csv",
        ),
        Command(
            "data register",
            "api.data_files:register",
            "bench data register my.csv --robot ur5 --licence CC-BY-4.0\n"
            "bench data register my.csv --dataset kr10-measured",
        ),
        Command(
            "data export",
            "api.data_sets:Dataset.export",
            "bench data export kr10-twin@plan=wide --output shared",
            _data_export,
        ),
    ],
    "Fit and test models": [
        Command(
            "run",
            "api.evaluation:evaluate",
            "bench run --model vjm --model vjm-gp --dataset fanuc-r2000ic --splits 5",
            _run,
        ),
        Command("reproduce", "", "bench reproduce paper-quick", _reproduce),
    ],
    "Read results": [
        Command(
            "leaderboard",
            "results.results:Results.leaderboard",
            "bench leaderboard --results results/runs",
            _leaderboard,
        ),
        Command(
            "compare",
            "results.results:Results.compare",
            "bench compare vjm-gp vjm --dataset fanuc-r2000ic",
            _compare,
        ),
        Command(
            "report",
            "page.report:report",
            "bench report --output report.html",
            _report,
        ),
        Command(
            "figure",
            "api.pictures:figure",
            "bench figure regression --output regression.pdf",
            _figure,
            without=("model",),
        ),
        Command(
            "table", "api.pictures:paper_table", "bench table 10", _table, without=("command",)
        ),
        Command(
            "merge",
            "store.merging:merge",
            "bench merge laptop/runs server/runs --output results/runs",
            show=_show_merge,
        ),
        Command(
            "results add",
            "",
            "bench results add results/submissions/quadratic-springs",
            _results_add,
        ),
        Command(
            "results export",
            "api.records:export_results",
            "bench results export --format csv --output results.csv",
            _results_export,
        ),
    ],
    "Use a model on your robot": [
        Command(
            "fit",
            "api.evaluation:model_and_data api.model:Model.fit api.model:Model.save",
            "bench fit --model gp-springs --data my.csv --robot ur5 --output my.stiff",
            _fit,
            without=("data", "robot"),
        ),
        Command(
            "predict",
            "api.model:Model.predict_file",
            "bench predict --model my.stiff --input poses.csv --output deflections.csv",
            _predict,
        ),
        Command(
            "path example",
            "api.tool_paths:example_path",
            "bench path example --shape circle --size 300mm --output circle.csv\n"
            "bench path example --model my.stiff --output square.csv",
        ),
        Command(
            "path compensate",
            "api.tool_paths:compensate_path api.robot_programs:compensate_program",
            "bench path compensate --model my.stiff --path circle.csv --output new.csv",
            _compensate,
        ),
        Command(
            "map",
            "api.stiffness_maps:stiffness_map",
            "bench map --model my.stiff --load 0,0,-100 --plane xz --output map.png",
            _map,
        ),
        Command(
            "posture",
            "api.postures:rank_postures",
            "bench posture --model my.stiff --point 900,0,800,0,90,0 --load 0,0,-50,0,0,0\n"
            "bench posture --model my.stiff --path holes.csv --output postures.csv",
            show=_show_postures,
        ),
        Command(
            "export",
            "api.model:Model.export",
            "bench export --model mlp.stiff --output mlp.onnx",
            _export,
        ),
    ],
    "Look up and add names": [
        Command("list", "", "bench list models", _list),
        Command("show", "api.registered:show", "bench show vjm-gp", show=_show_description),
        Command(
            "check",
            "model_tools.plugins:check",
            "bench check my-model --plugin my_model.py",
            show=_show_check,
        ),
        Command("new model", "model_tools.plugins:new_model", "bench new model my-model"),
    ],
    "Take part in the leaderboard": [
        Command(
            "submit",
            "api.submissions:submit",
            "bench submit --lite --card card.toml --output submission",
            _submit,
            without=("command",),
        ),
        Command("verify", "", "bench verify results/submissions/quadratic-springs", _verify),
    ],
}
"""Heading of the help page -> its commands."""
